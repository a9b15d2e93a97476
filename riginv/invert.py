"""python -m riginv.invert: a clip of meshes in, animation curves out, evaluated frame by frame by the true rig."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "invert")  # before the imports that take seconds

import functools
import importlib.metadata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import torch
from omegaconf import DictConfig

from riginv.animation.animation import Animation, FrameErrors
from riginv.animation.formats import check_formats
from riginv.clips.clip import Clip
from riginv.clips.description import describe
from riginv.clips.description_text import line, show_clip
from riginv.clips.open import open_clip, open_sequence
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.sequence import MeshSequence
from riginv.clips.topology import TopologyError, check_topology
from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig, to_typed
from riginv.config.values import Bound
from riginv.errors import InputError
from riginv.inference.bundle import bundle_folder
from riginv.inference.inverse import Inverse, load_inverse
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.size import show_rig
from riginv.runs.checksums import SUMS, sha256
from riginv.runs.console import show_lines
from riginv.runs.files import atomic_write, free_folder
from riginv.runs.locks import exclusive_lock
from riginv.runs.threads import single_threaded
from riginv.tracking.actors.actor import Actor, posed_actor
from riginv.tracking.actors.files import write_actor
from riginv.tracking.actors.finding import find_actor
from riginv.tracking.assembly import build_parts
from riginv.tracking.clip_optimum import with_accuracy, with_optimum
from riginv.tracking.markers.assembly import build_marker_parts
from riginv.tracking.markers.results import marker_errors, marker_remarks, write_marker_tables
from riginv.tracking.markers.tracking import track_markers
from riginv.tracking.markers.views import write_marker_views
from riginv.tracking.options import AfterOptions, LookOptions, TrackingOptions
from riginv.tracking.report import InversionProgress, show
from riginv.tracking.results import source_of, write_curves, write_look, write_views
from riginv.tracking.rigs import build_rig, build_true_rig
from riginv.tracking.run import invert_clip, invert_smoothly
from riginv.tracking.surfaces.assembly import build_scan_parts
from riginv.tracking.surfaces.results import frame_errors, remarks_of, write_scan_table
from riginv.tracking.surfaces.scan_files import holds_scans
from riginv.tracking.surfaces.tracking import track_scans
from riginv.tracking.surfaces.views import ScanViews

Formats = Annotated[Sequence[str], Bound("a list: formats=[csv,glb]", lambda value: True)]


@dataclass(frozen=True, kw_only=True)
class InvertConfig(TrackingOptions):
    """The config of `riginv.invert`; conf/invert.yaml explains each key."""

    rig: ClassSpec[RigBackend] | None
    true_rig: ClassSpec[RigBackend] | None
    reading: ReadingOptions
    frames: FrameOptions
    clip: str
    out: str
    bundle: str | None
    formats: Formats
    after: AfterOptions
    look: LookOptions
    mesh_space: MeshSpaceConfig

    def __post_init__(self) -> None:
        super().__post_init__()
        self.resolved_method(bool(self.bundle))
        if self.bundle and self.correspondence in ("surface", "markers"):
            raise InputError(f"correspondence={self.correspondence} needs no network: give rig=NAME in place of bundle=DIR")
        if self.bundle and self.landmarks.is_given:
            raise InputError("landmarks are for scans, which need no network: give rig=NAME in place of bundle=DIR")
        if not self.bundle and self.rig is None:
            raise InputError("the rig of the clip is not given: add rig=NAME, or bundle=DIR (a trained inverse)")


@single_threaded()  # operations are small: threads would wait for each other
def invert(config: DictConfig) -> None:
    """Invert `config.clip` into a folder `config.out` of curves, errors of each frame, and views of the result."""
    settings = to_typed(config, InvertConfig)
    out = free_folder(settings.out)
    inverse, rig, true_rig = build_rigs(settings)
    check_formats(true_rig, settings.formats)
    if settings.correspondence == "markers":
        invert_markers(settings, rig, true_rig, out)
        return
    is_surface, notes, sequence = by_surface(settings.clip, settings, true_rig, settings.reading, inverse is not None)
    if is_surface:
        invert_surface(settings, rig, true_rig, notes, out)
        return
    clip, read_notes = open_clip(settings.clip, true_rig, settings.reading, settings.frames, sequence)
    invert_vertices(settings, clip, rig, true_rig, inverse, [*notes, *read_notes], out)


def build_rigs(settings: InvertConfig) -> tuple[Inverse | None, LinearRig, RigBackend]:
    """The trained inverse, if any, the rig to solve for, and the true rig."""
    inverse, named = None, None
    if settings.bundle:
        named = settings.rig.build() if settings.rig else None
        inverse = load_inverse(settings.bundle, named)
        rig = inverse.rig
    else:
        assert settings.rig is not None
        rig = build_rig(settings.rig, settings.mesh_space)
    true_rig = build_true_rig(settings.true_rig, named or rig)
    return inverse, rig, rig if true_rig.held_out is not None else true_rig


def by_surface(
    path: str, options: TrackingOptions, rig: RigBackend, reading: ReadingOptions, has_network: bool
) -> tuple[bool, list[str], MeshSequence | None]:
    """Whether a clip is inverted by its surface, notes for the user, and the clip where it was opened to know.

    Raises:
        InputError: the file cannot be read, or has the rig's vertices in another order.
    """
    if options.landmarks.is_given:
        return True, [], None
    if has_network and holds_scans(path):
        raise InputError(f"{path}: scans are fitted by their surface, without a network: give rig=NAME in place of bundle=DIR")
    if options.correspondence != "auto" or has_network or reading.vertices is not None or Path(path).suffix == ".csv":
        return options.correspondence == "surface", [], None
    if holds_scans(path):
        return True, ["scans: fitted by their surface (correspondence=surface)"], None
    sequence = open_sequence(path, rig, reading)
    try:
        check_topology(sequence, rig, reading.check_faces)
    except TopologyError as error:
        if error.same_count:  # the vertices are in another order, which the user must correct
            raise InputError(f"{error}, and correspondence=surface fits its surface") from None
        reason = str(error).removeprefix(f"{path}: ").partition(": ")[0]
        return True, [f"{reason}: fitted by its surface (correspondence=vertices refuses such clips)"], None
    return False, ["the clip is read as the rig's own mesh, vertex by vertex (correspondence=surface: as a scan)"], sequence


def invert_vertices(
    settings: InvertConfig,
    clip: Clip,
    rig: LinearRig,
    true_rig: RigBackend,
    inverse: Inverse | None,
    notes: list[str],
    out: Path,
) -> None:
    """Invert a clip of the rig's own mesh, and write the folder `out`."""
    described = show_clip(clip)
    show_rig(true_rig, settings.rig.config if settings.rig else None)
    actor = find_actor(settings, settings.reading, clip, rig, true_rig)
    parts = build_parts(settings, clip, rig, true_rig, inverse, actor)
    notes = [*notes, *([*actor.notes, f"the actor is {actor.sentence}"] if actor else []), *parts.notes]
    with exclusive_lock(out), InversionProgress(len(clip), notes) as progress:
        free_folder(settings.out)
        arguments = (clip, parts.inverter, parts.evaluator, settings.window, progress.advance)
        inversion = invert_smoothly(*arguments, settings.solver) if parts.method == "clip" else invert_clip(*arguments)

        @functools.cache
        def find_errors() -> FrameErrors:
            errors = with_optimum(inversion.errors, clip, inversion, parts.evaluator)
            return with_accuracy(errors, clip, inversion, true_rig)

        facts, source = made_by(settings, parts.method, actor), Path(settings.clip).name
        animation = Animation(true_rig, inversion.controls, clip.fps, clip.frame_numbers, inversion.motion, source, facts)
        with atomic_write(out) as folder:
            folder.mkdir()
            curves = (describe(clip), settings.formats, settings.after, progress.advance)
            progress.advance("the optimum", 0)
            files, remarks = write_curves(folder, animation, find_errors, *curves)
            errors = find_errors()
            shown = replace(animation, rig=posed_actor(true_rig, actor))
            views, view_notes = write_views(folder, clip, shown, errors, settings.look, progress.advance, actor)
    warnings = describe(clip).new_warnings(described) if described else []
    remarks += [*view_notes, *(f"warning: {warning}" for warning in warnings)]
    show(animation, errors, true_rig, out, [*files, *views], remarks)


def invert_surface(settings: InvertConfig, rig: LinearRig, true_rig: RigBackend, notes: list[str], out: Path) -> None:
    """Invert a clip of scans by their surfaces, and write the folder `out`."""
    parts = build_scan_parts(settings.clip, settings, rig, settings.reading, settings.frames)
    described = parts.describe()
    show_lines([line(described)])
    show_rig(true_rig, settings.rig.config if settings.rig else None)
    numbers = parts.frame_numbers
    with exclusive_lock(out), InversionProgress(len(numbers), [*notes, *parts.notes]) as progress:
        free_folder(settings.out)
        track = track_scans(
            parts.solver, parts.scans, parts.units, parts.rows, parts.smoothness, progress.advance, parts.landmarks
        )
        facts, source = made_by(settings, "surface", parts.actor), Path(settings.clip).name
        motion = track.motion if parts.solver.moves else None
        animation = Animation(true_rig, track.controls, parts.units.fps, numbers, motion, source, facts)
        errors = frame_errors(track, numbers)
        with atomic_write(out) as folder:
            folder.mkdir()
            curves = (described, settings.formats, settings.after, progress.advance)
            files, curve_notes = write_curves(folder, animation, errors, *curves)
            files += write_scan_table(folder, track, numbers)
            if parts.actor is not None:
                files += write_actor(folder, parts.actor, rig.faces, settings.look.sheet)
            views = ScanViews(parts, track, posed_actor(true_rig, parts.actor))
            shown = replace(animation, rig=views.rig)
            looks = (settings.look, source_of(described), views.nearest, progress.advance, views.scans)
            names, view_notes = write_look(folder, shown, errors, *looks)
    rows = ("scan's points from the rig", "rig's skin from the scan")
    remarks = [*remarks_of(track), *curve_notes, *view_notes]
    show(animation, errors, true_rig, out, [*files, *names], remarks, "mean surface distances", rows)


def invert_markers(settings: InvertConfig, rig: LinearRig, true_rig: RigBackend, out: Path) -> None:
    """Invert a clip of markers, and write the folder `out`."""
    parts = build_marker_parts(settings.clip, settings, rig, settings.reading, settings.frames)
    described = parts.describe()
    show_lines([line(described)])
    show_rig(true_rig, settings.rig.config if settings.rig else None)
    numbers = torch.from_numpy(parts.clip.frame_numbers)
    with exclusive_lock(out), InversionProgress(len(numbers), parts.notes) as progress:
        free_folder(settings.out)
        noise_mm, is_smooth = settings.noise_of_measurements_mm, settings.method != "levenberg_marquardt"
        arguments = (parts.points, numbers, settings.solver, noise_mm, is_smooth, progress.advance)
        track = track_markers(parts.objective, *arguments)
        facts, source = made_by(settings, "markers"), Path(settings.clip).name
        animation = Animation(true_rig, track.controls, parts.units.fps, numbers, track.motion, source, facts)
        errors = marker_errors(track, true_rig, numbers, settings.flags)
        with atomic_write(out) as folder:
            folder.mkdir()
            curves = (described, settings.formats, settings.after, progress.advance)
            files, curve_notes = write_curves(folder, animation, errors, *curves)
            files += write_marker_tables(folder, track, errors, numbers)
            looks = (settings.look, described, progress.advance)
            views, view_notes = write_marker_views(folder, track, animation, errors, *looks)
    rows = ("mean over the markers", "farthest marker")
    remarks = [*marker_remarks(errors), *curve_notes, *view_notes]
    show(animation, errors, true_rig, out, [*files, *views], remarks, "distances of the markers", rows)


def made_by(settings: InvertConfig, method: str, actor: Actor | None = None) -> dict[str, Any]:
    """The version, method, bundle and actor of an inversion, for curves.json."""
    facts = {"riginv": importlib.metadata.version("riginv"), "method": method, "refine": settings.refine}
    if settings.mean_steps:
        facts["mean_steps"] = settings.mean_steps
    if settings.bundle:
        facts["bundle"] = sha256(bundle_folder(settings.bundle) / SUMS)
    if actor is not None:
        facts["actor"] = actor.as_json()
    return facts


if __name__ == "__main__":
    command("invert")(invert)()
