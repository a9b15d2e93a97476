"""Scans on the page of an inversion: each with points and faces of its own, drawn beside the recovered mesh."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from riginv.tracking.viewer.thinning import thin

MAX_POINTS = 4000  # of a scan on the page
MAX_SCANS = 240
FARTHEST = 32_767  # of the quantised positions
BEYOND = 65_535  # quantised distance of points that the rig has no counterpart for


class DrawnScan(NamedTuple):
    """A scan without its rigid motion.

    Attributes:
        points: `(point, 3)`, mm.
        normals: `(point, 3)`, of unit length.
        faces: `(face, 3)`; none for a point cloud.
        distance: of each point from the rig, `(point,)`, mm; NaN beyond the rig's border.
    """

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    distance: np.ndarray

    def thinned(self) -> "DrawnScan":
        """At most `MAX_POINTS` of its points, with the faces between them."""
        points, faces = self.points, self.faces
        if len(faces):
            kept, faces = thin(points, faces, MAX_POINTS)
        else:
            kept = np.unique(np.linspace(0, len(points) - 1, min(MAX_POINTS, len(points))).astype(int))
        return DrawnScan(points[kept], self.normals[kept], faces, self.distance[kept])


Scans = Callable[[int], DrawnScan | None]  # a row of the animation to its scan, if it has one

NO_SCAN = DrawnScan(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros(0))


def drawn(scans: Scans, rows: Sequence[int]) -> list[DrawnScan]:
    """The scans of rows of an animation, thinned; without points where there is none."""
    found = (scans(row) for row in rows)
    return [NO_SCAN if scan is None else scan.thinned() for scan in found]


def scan_bytes(scans: Sequence[DrawnScan], middle: np.ndarray, step: float) -> tuple[list[tuple[int, int]], bytes]:
    """The numbers of points and faces of each scan, and all scans for scene.js.

    Positions relative to `middle` and distances are integers in units of `step`, mm; all positions come first, then all
    distances, faces, and normals.
    """
    positions = [np.clip(((scan.points - middle) / step).round(), -FARTHEST, FARTHEST).astype("<i2") for scan in scans]
    steps = [np.minimum((scan.distance / step).round(), BEYOND - 1) for scan in scans]
    distances = [np.where(np.isnan(values), BEYOND, values).astype("<u2") for values in steps]
    faces = [scan.faces.astype("<u2") for scan in scans]
    normals = [(127 * scan.normals).round().astype("i1") for scan in scans]
    parts = [array.tobytes() for arrays in (positions, distances, faces, normals) for array in arrays]
    return [(len(scan.points), len(scan.faces)) for scan in scans], b"".join(parts)
