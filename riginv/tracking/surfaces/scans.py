"""Scans: meshes or point clouds whose number of points may differ from frame to frame."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.sequence import SourceFacts
from riginv.errors import InputError
from riginv.tracking.surfaces.triangles import PointCloud, Surface, TriangleMesh

MIN_POINTS = 50


class Scan(NamedTuple):
    """One scan, in the units and axes of its file.

    Attributes:
        points: `(point, 3)`.
        faces: `(face, 3)`; None for a point cloud.
        normals: of a point cloud, `(point, 3)`; None: they are estimated.
    """

    points: np.ndarray
    faces: np.ndarray | None = None
    normals: np.ndarray | None = None

    def cleaned(self) -> "Scan | None":
        """The scan without non-finite points, degenerate faces, and mesh points that no face uses; equal points are merged.

        None where fewer than 50 points remain: too few to fit. Normals are dropped where some have no direction.
        """
        kept, merged = distinct_points(self.points)
        points, faces = self.points[kept], None if self.faces is None else merged[self.faces]
        known = np.isfinite(points).all(axis=1)
        used = known
        if faces is not None:
            corners = np.where(known[:, None], points, 0.0)[faces]
            area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
            faces = faces[known[faces].all(axis=1) & (area > 0)]
            used = np.zeros(len(known), bool)
            used[faces] = True
        if used.sum() < MIN_POINTS:
            return None
        renumbered = np.cumsum(used) - 1
        normals = None if self.normals is None else self.normals[kept][used]
        if normals is not None and not (np.isfinite(normals).all(axis=1) & (normals != 0).any(axis=1)).all():
            normals = None
        return Scan(points[used], None if faces is None else renumbered[faces], normals)

    def surface(self, mm: float, axes: np.ndarray, shift: np.ndarray | float = 0.0) -> Surface:
        """The scan as a surface in millimetres, y up.

        Args:
            mm: millimetres per unit.
            axes: rotation `(3, 3)` to y up.
            shift: after the rotation, `(3,)`, mm.
        """
        points = mm * self.points.astype(np.float64) @ axes.T + shift
        if self.faces is not None:
            return TriangleMesh(points, self.faces)
        return PointCloud(points, None if self.normals is None else self.normals @ axes.T)


class ScanSequence(ABC):
    """A sequence of scans; one is in memory at a time. Attributes as in `MeshSequence`."""

    _last: tuple[int, Scan | None] | None = None  # the index that was cleaned last, and its scan: the first is asked for often

    def __init__(
        self,
        path: str | Path,
        frame_numbers: np.ndarray,
        facts: SourceFacts,
        fps: float | None = None,
        unit_mm: float | None = None,
        up: str | None = None,
    ) -> None:
        self.path, self.frame_numbers = str(path), np.asarray(frame_numbers, np.int64)
        self.facts, self.fps, self.unit_mm, self.up = facts, fps, unit_mm, up
        if not len(self.frame_numbers):
            raise InputError(f"{path}: no frames in it; expected at least one scan: export it again")

    def __len__(self) -> int:
        return len(self.frame_numbers)

    def cleaned(self, index: int) -> Scan | None:
        """The cleaned scan of a frame, by its index; None where there is none, as for an index of -1.

        Raises:
            InputError: as `scan`.
        """
        if index < 0:
            return None
        last = self._last  # read once: other threads may replace it
        if last is None or last[0] != index:
            scan = self.scan(index)
            last = self._last = index, None if scan is None else scan.cleaned()
        return last[1]

    def check(self, indices: Sequence[int]) -> None:
        """Read scans that are read quickly, so that a damaged one is refused before the work starts, not in its midst.

        Raises:
            InputError: as `scan`.
        """
        return

    @abstractmethod
    def scan(self, index: int) -> Scan | None:
        """The scan of a frame, by its index; None where there is none.

        Raises:
            InputError: the file turns out to be damaged there.
        """


def distinct_points(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The indices of points `(point, 3)` without those that repeat an earlier one, ascending, and the new index of each.

    Exporters split vertices at seams, or at every face: such a mesh would consist of borders.
    """
    rows = np.ascontiguousarray(points) + 0.0  # -0.0 and 0.0 are equal, and differ in their bytes
    whole = rows.view(np.dtype((np.void, rows.dtype.itemsize * 3))).reshape(-1)
    _, first, group = np.unique(whole, return_index=True, return_inverse=True)
    kept = np.sort(first)
    return kept, np.searchsorted(kept, first[group.reshape(-1)])
