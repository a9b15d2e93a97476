"""The landmarks of a clip of scans, from a map of the rig's markers and a take of their positions."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy

from riginv.clips.markers import MarkerClip, open_markers
from riginv.clips.options import ReadingOptions
from riginv.clips.units import TO_Y_UP, ClipUnits
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.tracking.markers.map_file import matched, read_map, read_points
from riginv.tracking.markers.placement import Placement
from riginv.tracking.options import LandmarkOptions
from riginv.tracking.surfaces.landmarks import FEWEST, Landmarks
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.scans import ScanSequence
from riginv.tracking.surfaces.units import robust_size

NEAR, AWAY = 0.05, 0.2  # median distance of landmarks from a scan, relative to its size: in its space, and not in it


@dataclass(frozen=True)
class LandmarkTake:
    """The landmarks of a clip of scans.

    Attributes:
        placement: on the rig's surface.
        points: observed, `(scan, landmark, 3)`, mm, y up, in the scans' space; NaN where unknown.
        weight: as in `Landmarks`.
    """

    placement: Placement
    points: np.ndarray
    weight: float

    def at(self, index: int) -> Landmarks | None:
        """The landmarks that were observed in a scan, by its index; None where there are none."""
        known = np.flatnonzero(np.isfinite(self.points[index]).all(axis=1))
        return Landmarks(self.placement.subset(known.tolist()), self.points[index, known], self.weight) if len(known) else None

    def distances(self, index: int, vertices: np.ndarray, motion: Motion) -> np.ndarray:
        """Distances of a scan's landmarks from those of a mesh `(vertex, 3)` in the rig's frame, `(landmark,)`, mm."""
        ours = Landmarks(self.placement, self.points[index]).on(vertices)
        return np.linalg.norm(ours - motion.undo(self.points[index]), axis=1)


def landmarks_of_scan(named: str | None, rig: RigBackend, cloud: np.ndarray, units: ClipUnits) -> Landmarks | None:
    """The landmarks of one scan: a map whose markers have positions, too; None where no file is named.

    Args:
        named: the map's path.
        cloud: the points of the scan, `(point, 3)`, in its own unit and axes, as the positions are.

    Raises:
        InputError: the map is damaged, has fewer than three landmarks, or they do not lie on the scan.
    """
    if not named:
        return None
    path = Path(named)
    placement = read_map(path, rig)
    if len(placement) < FEWEST:
        raise InputError(f"{path}: {len(placement)} landmarks, expected {FEWEST} at least: add more")
    points = read_points(path, placement.names)
    away = float(np.median(scipy.spatial.cKDTree(cloud).query(points)[0]))
    if away > AWAY * robust_size(cloud):
        raise InputError(
            f"{path}: its points lie {units.mm * away:.3g} mm from the scan, expected near it: give them in the scan's unit"
        )
    return Landmarks(placement, units.mm * points @ units.axes.double().numpy().T)


class _Space(NamedTuple):
    """Millimetres per unit, the rotation to y up, and what they are, in words."""

    mm: float
    axes: np.ndarray
    words: str


def read_landmarks(
    options: LandmarkOptions, rig: RigBackend, reading: ReadingOptions, scans: ScanSequence, units: ClipUnits
) -> tuple[LandmarkTake | None, list[str]]:
    """The landmarks of a clip, and notes; None where the options name none.

    The landmarks are in the space of the scans; their unit is the file's, if it has one, else that of the scans.

    Raises:
        InputError: a file cannot be read, names do not match, no frame has landmarks, or they do not lie on the scans.
    """
    if options.map is None or options.clip is None:
        return None, []
    given = read_map(Path(options.map), rig)
    clip, placement, notes = matched(open_markers(options.clip), given, options.map, reading, FEWEST)
    rows = _rows(clip, scans)
    points = np.where(rows[:, None, None] >= 0, clip.points[rows], np.nan).astype(np.float64)
    seen = np.isfinite(points).all(axis=2).sum(axis=1) > 0
    if not seen.any():
        raise InputError(f"{clip.path}: it has no landmark in any frame of the scans, only gaps: export their positions")
    if not seen.all():
        notes.append(f"{int(seen.sum())} of {len(scans)} scans have landmarks")
    space, more = _space(clip, points, scans, units, reading.scale)
    return LandmarkTake(placement, space.mm * points @ space.axes.T, options.weight), [*clip.facts.notes, *notes, *more]


def _rows(clip: MarkerClip, scans: ScanSequence) -> np.ndarray:
    """The row of a take at each scan's frame number, `(scan,)`; -1 where it has none."""
    rows = np.searchsorted(clip.frame_numbers, scans.frame_numbers).clip(max=len(clip.frame_numbers) - 1)
    rows = np.where(clip.frame_numbers[rows] == scans.frame_numbers, rows, -1)
    if (rows < 0).all():
        ours, theirs = (f"{each[0]} to {each[-1]}" for each in (clip.frame_numbers, scans.frame_numbers))
        raise InputError(f"{clip.path}: it has frames {ours}, and the scans {theirs}, none in common: renumber the frames")
    return rows


def _space(
    clip: MarkerClip, points: np.ndarray, scans: ScanSequence, units: ClipUnits, scale: float
) -> tuple[_Space, list[str]]:
    """The space in which landmarks `(scan, landmark, 3)` lie on the scans, and notes where it is another than expected."""
    first = _first_scan(points, scans)
    if first is None:
        return _Space(units.mm, units.axes.double().numpy(), ""), []
    index, cloud = first
    upright, known = units.axes.double().numpy(), points[index][np.isfinite(points[index]).all(axis=1)]
    tree = scipy.spatial.cKDTree(units.mm * cloud @ upright.T)
    sizes = [(units.mm, "the scans' unit")]
    if clip.unit_mm:
        sizes.insert(0, (clip.unit_mm * scale, "the unit of its file"))
    axes = [(upright, "the scans' axes")]
    if clip.up and clip.up != units.up:
        axes.append((TO_Y_UP[clip.up].double().numpy(), f"{clip.up} up"))
    spaces = [_Space(mm, rotation, f"{unit} and {up}") for rotation, up in axes for mm, unit in sizes]
    away = [float(np.median(tree.query(space.mm * known @ space.axes.T)[0])) for space in spaces]
    size = units.mm * robust_size(cloud)
    if away[0] <= NEAR * size:
        return spaces[0], []
    best = int(np.argmin(away))
    if away[best] > AWAY * size:
        raise InputError(
            f"{clip.path}: its landmarks lie {away[best]:.3g} mm from the scan of frame {scans.frame_numbers[index]}, expected "
            f"near it: export landmarks and scans in one space, with the unit of both"
        )
    return spaces[best], [f"the landmarks were read in {spaces[best].words}: so they lie nearest to the scans"] if best else []


def _first_scan(points: np.ndarray, scans: ScanSequence) -> tuple[int, np.ndarray] | None:
    """The index of a scan with most landmarks, and its points; None where no scan with landmarks has points."""
    counts = np.isfinite(points).all(axis=2).sum(axis=1)
    for index in np.argsort(-counts, kind="stable").tolist():
        cleaned = scans.cleaned(index) if counts[index] else None
        if cleaned is not None:
            return index, cleaned.points.astype(np.float64)
    return None
