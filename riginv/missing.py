"""python -m riginv.missing: the shapes that a rig lacks for a clip, and the products of controls that drive them."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "missing")  # before the imports that take seconds

from dataclasses import dataclass, replace

import torch
from omegaconf import DictConfig
from rich.console import Console
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.clips.description_text import show_clip
from riginv.clips.open import open_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig, to_typed
from riginv.config.values import PositiveInt
from riginv.errors import InputError
from riginv.geometry.neighbours import evenly
from riginv.inference.inverse import Inverse, load_inverse
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.console import show_lines
from riginv.runs.files import atomic_write, free_folder
from riginv.runs.locks import exclusive_lock
from riginv.tracking.alternation import WindowInverter, WindowResult
from riginv.tracking.assembly import build_parts
from riginv.tracking.missing.finding import find_missing
from riginv.tracking.missing.results import rows_of, sentence, table_of, write_missing
from riginv.tracking.options import TrackingOptions
from riginv.tracking.report import InversionProgress
from riginv.tracking.rigid import fit_rigid
from riginv.tracking.rigs import build_rig

MAX_NUMBERS = 60_000_000  # of all meshes together: 240 MB


@dataclass(frozen=True, kw_only=True)
class MissingConfig(TrackingOptions):
    """The config of `riginv.missing`; conf/missing.yaml explains each key."""

    rig: ClassSpec[RigBackend] | None
    reading: ReadingOptions
    frames: FrameOptions
    clip: str
    out: str
    bundle: str | None
    curves: str | None
    shapes: PositiveInt
    factors: PositiveInt
    max_frames: PositiveInt
    mesh_space: MeshSpaceConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.factors > 6:
            raise InputError(f"factors is {self.factors}, expected 1 to 6: products of more controls are too many to try")
        if self.method in ("network", "clip"):
            raise InputError(
                f"method={self.method}: expected refined or levenberg_marquardt, which solve each frame to the end"
            )
        if self.landmarks.is_given:
            raise InputError("landmarks are for scans, which have no vertices to find shapes from: leave landmarks.* out")
        if not self.bundle and self.rig is None:
            raise InputError("the rig of the clip is not given: add rig=NAME, or bundle=DIR (a trained inverse)")

    def with_method(self) -> "MissingConfig":
        """The same with the default method for what is given."""
        chosen = replace(self, method=self.method or ("refined" if self.bundle else "levenberg_marquardt"))
        chosen.resolved_method(bool(self.bundle))
        return chosen


def run(config: DictConfig) -> None:
    """Find the shapes that the rig lacks for `config.clip`, and write them into the folder `config.out`."""
    settings = to_typed(config, MissingConfig).with_method()
    out = free_folder(settings.out)
    inverse, rig = build_solved_rig(settings)
    clip, notes = open_clip(settings.clip, rig, settings.reading, settings.frames)
    if clip.controls is not None:
        raise InputError(f"{settings.clip}: curves of the rig's controls: the rig makes them exactly; give meshes of the clip")
    true_curves = true_controls(settings, clip, rig)
    show_clip(clip)
    with exclusive_lock(out), InversionProgress(min(len(clip), settings.max_frames), notes) as progress:
        meshes, controls, rows = invert_spread_frames(settings, clip, rig, inverse, true_curves, progress)
        numbers = clip.frame_numbers[rows]
        progress.advance("missing shapes", 0)
        missing = find_missing(rig, meshes, controls, settings.shapes, settings.factors, true_curves is not None)
        facts = rows_of(missing, numbers) if missing else []
        if missing:
            with atomic_write(out) as folder:
                folder.mkdir()
                files = write_missing(folder, missing, facts)
    console = Console()
    if not missing:
        show_lines(["  The rig lacks no shape for this clip: nothing was written."], console=console)
        return
    console.print(table_of(missing, facts))
    show_lines(
        [
            f"  {sentence(missing)}",
            f"  {out}: {', '.join(files)}; with rig=shapes, copy an OBJ file into the rig's folder to add its shape",
        ],
        console=console,
    )


def true_controls(settings: MissingConfig, clip: Clip, rig: LinearRig) -> Tensor | None:
    """The controls `(frame, control)` of all frames of a clip from `settings.curves`; None: they are not known.

    Raises:
        InputError: the curves are none of the rig, or have other frames.
    """
    if settings.curves is None:
        return None
    curves = open_clip(settings.curves, rig, ReadingOptions(), settings.frames)[0]
    if curves.controls is None:
        raise InputError(f"curves={settings.curves}: meshes, expected curves of the rig's controls (.csv or .npz)")
    if not torch.equal(curves.frame_numbers, clip.frame_numbers):
        raise InputError(
            f"curves={settings.curves}: {len(curves)} frames, and {settings.clip} has {len(clip)}, or other numbers"
        )
    return curves.controls.to(rig.lower)


def build_solved_rig(settings: MissingConfig) -> tuple[Inverse | None, LinearRig]:
    """The trained inverse, if any, and the rig to solve for.

    Raises:
        InputError: the rig is known by recorded poses or by a surrogate.
    """
    if settings.bundle:
        inverse = load_inverse(settings.bundle, settings.rig.build() if settings.rig else None)
        rig = inverse.rig
    else:
        assert settings.rig is not None
        inverse, rig = None, build_rig(settings.rig, settings.mesh_space)
    if rig.is_surrogate or rig.true_rig().held_out is not None:
        raise InputError(
            f"rig '{rig.name}' is known by a surrogate or by recorded poses alone: its missing shapes cannot be determined"
        )
    return inverse, rig


def invert_spread_frames(
    settings: MissingConfig,
    clip: Clip,
    rig: LinearRig,
    inverse: Inverse | None,
    known: Tensor | None,
    progress: InversionProgress,
) -> tuple[Tensor, Tensor, Tensor]:
    """Meshes without rigid motion `(frame, vertex, 3)`, controls and rows of frames that are evenly spread."""
    parts = build_parts(settings, clip, rig, rig, inverse)
    most = max(1, min(settings.max_frames, MAX_NUMBERS // rig.rest_vertices.numel()))
    rows = evenly(most, len(clip))
    meshes, controls, kept = [], [], []
    for some in rows.split(settings.window):
        vertices = torch.cat([clip.vertices(row, row + 1) for row in some.tolist()])
        found = parts.inverter.invert(vertices) if known is None else unsolved(parts.inverter, vertices, known[some])
        meshes.append(found.filled[found.solvable])
        controls.append(found.controls[found.solvable])
        kept.append(some[found.solvable])
        progress.advance("inverting", len(some))
    if not len(torch.cat(kept)):
        raise InputError(f"{settings.clip}: no frame has enough known vertices: there is nothing to invert")
    return torch.cat(meshes), torch.cat(controls), torch.cat(kept)


def unsolved(inverter: WindowInverter, vertices: Tensor, controls: Tensor) -> WindowResult:
    """The meshes of known controls, without the rigid motion that fits them best."""
    motion = None
    if inverter.anchors is not None:
        anchors = inverter.anchors.for_window(torch.isfinite(vertices).all(dim=2))
        motion = fit_rigid(anchors.mesh(controls), vertices[:, anchors.vertices], anchors.weights)
    return inverter.result(vertices, controls, motion, torch.ones(len(vertices), dtype=torch.bool))


if __name__ == "__main__":
    command("missing")(run)()
