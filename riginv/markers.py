"""python -m riginv.markers: a map of markers to a rig's surface, proposed from a neutral frame, or places to put markers."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "markers")  # before the imports that take seconds

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from omegaconf import DictConfig
from PIL import Image

from riginv.clips.markers import MarkerClip, open_markers
from riginv.clips.options import ReadingOptions
from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig, to_typed
from riginv.config.values import NonNegativeInt, PositiveInt
from riginv.errors import InputError, counted, listed
from riginv.meshes.rendering import Camera, grid
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.console import show_lines
from riginv.runs.files import atomic_write, free_file
from riginv.runs.threads import single_threaded
from riginv.tracking.markers.assembly import frame_units, in_millimetres
from riginv.tracking.markers.layout import NOISE_MM, SPACING, suggest_layout
from riginv.tracking.markers.map_file import read_map, write_map
from riginv.tracking.markers.placement import Placement
from riginv.tracking.markers.proposing import propose
from riginv.tracking.markers.views import RigWithMarkers
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.rigs import build_rig

TURNS = (-60.0, 0.0, 60.0)  # degrees of the cameras
FAR = 3.0  # times the median distance, from which a marker is named


@dataclass(frozen=True)
class MarkersConfig:
    """The config of `riginv.markers`; conf/markers.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    out: str
    clip: str | None
    frame: NonNegativeInt | None
    anchors: str | None
    pose: bool
    calibrate: bool
    count: PositiveInt | None
    reading: ReadingOptions
    mesh_space: MeshSpaceConfig

    def __post_init__(self) -> None:
        if (self.clip is None) == (self.count is None):
            raise InputError("give clip=TAKE.c3d, whose markers are mapped, or count=50, for places to put so many markers")
        if Path(self.out).suffix.lower() not in (".yaml", ".yml"):
            raise InputError(f"out={self.out}: expected a file that ends in .yaml")


@single_threaded()  # operations are small
def run(config: DictConfig) -> None:
    """Write the map `config.out`, and a picture of it."""
    settings = to_typed(config, MarkersConfig)
    out = free_file(settings.out)
    rig = build_rig(settings.rig, settings.mesh_space)
    comments: dict[str, str] = {}
    if settings.count is not None:
        placement = suggest_layout(rig, default_prior(rig), settings.count, NOISE_MM, None)
        lines = [f"  {len(placement)} places on rig '{rig.name}', the most informative first"]
        if len(placement) < settings.count:
            lines.append(f"  count={settings.count} would put them nearer to each other than {SPACING:.0%} of the rig's size")
    else:
        placement, distance, lines = _proposed(settings, rig)
        comments = {name: f"{mm:.1f} mm from the surface" for name, mm in zip(placement.names, distance.tolist())}
    write_map(out, placement, rig, comments)
    picture = out.with_suffix(".png")
    with atomic_write(picture) as file:
        draw(rig, placement).save(file, format="PNG")
    todo = "check in the picture that each marker is where it is on the actor, then"
    if settings.clip is None:
        todo = "put markers of these names there on the actor, record a take, then"
    show_lines([*lines, f"  {out}, {picture}: {todo} riginv invert correspondence=markers markers={out} clip=TAKE out=DIR"])


def _proposed(settings: MarkersConfig, rig: LinearRig) -> tuple[Placement, np.ndarray, list[str]]:
    """The map of a clip's markers, their distances from the rig, and lines for the user."""
    assert settings.clip is not None
    clip = open_markers(settings.clip)
    row, anchors = _row(clip, settings.frame), None
    is_known = np.isfinite(clip.points[row]).all(axis=1)
    names = tuple(name for name, there in zip(clip.names, is_known) if there)
    if len(names) < 4:
        raise InputError(
            f"{clip.path}: frame {clip.frame_numbers[row]} has {counted(len(names), 'marker')}, expected 4 at least: frame=N"
        )
    frame = clip.select(names, clip.points[row : row + 1, is_known], clip.frame_numbers[row : row + 1])
    if settings.anchors is not None:
        anchors = _anchors(settings.anchors, names, rig)
    units = frame_units(frame, anchors, rig, settings.reading)
    points = in_millimetres(frame.points, units)[0].double().numpy()
    proposal = propose(rig, names, points, anchors, settings.pose, settings.calibrate)
    far = proposal.distance_mm > FAR * np.median(proposal.distance_mm) + 1
    lines = [
        f"  {counted(len(names), 'marker')} of frame {frame.frame_numbers[0]}, {proposal.distance_mm.mean():.2g} mm from rig "
        f"'{rig.name}' on average, {proposal.distance_mm.max():.2g} mm at most"
    ]
    lines += [f"  note: {note}" for note in units.notes if "frames a second" not in note]
    if len(names) < len(clip.names):
        lines.append(
            f"  note: in a gap there: {counted(len(clip.names) - len(names), 'marker')}: add by hand, or take another frame=N"
        )
    if far.any():
        lines.append(f"  far from the rig, check their labels: {listed(np.array(names)[far])}")
    if proposal.rivals:
        lines.append("  warning: the rig fits nearly as well in another rotation: give three markers in anchors=FILE.yaml")
    return proposal.placement, proposal.distance_mm, lines


def _row(clip: MarkerClip, frame: int | None) -> int:
    """The row of a frame by its number; None: the first of those with most markers."""
    if frame is None:
        return int(np.isfinite(clip.points).all(axis=2).sum(axis=1).argmax())
    rows = np.flatnonzero(clip.frame_numbers == frame)
    if not len(rows):
        raise InputError(f"frame={frame}: {clip.path} has frames {clip.frame_numbers[0]} to {clip.frame_numbers[-1]}")
    return int(rows[0])


def _anchors(path: str, names: tuple[str, ...], rig: RigBackend) -> Placement:
    """The known places of some of the markers."""
    known = read_map(Path(path), rig)
    kept = [row for row, name in enumerate(known.names) if name in names]
    if len(kept) < 3:
        raise InputError(f"anchors={path}: names {len(kept)} markers of the frame, expected 3 at least")
    return known.subset(kept)


def draw(rig: RigBackend, placement: Placement) -> Image.Image:
    """A picture of the rig at rest with its markers as balls, from three sides."""
    shown = RigWithMarkers(rig, placement, detail=1)
    vertices, colors = shown.rest_vertices.cpu(), shown.vertex_colors().numpy()
    pictures = [Camera(rig.rest_vertices, turn).picture(vertices, shown.faces, colors) for turn in TURNS]
    return grid(pictures, ["", counted(len(placement), "marker"), ""], columns=len(pictures))


if __name__ == "__main__":
    command("markers")(run)()
