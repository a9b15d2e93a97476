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
        balls: the number of points, the last ones, that are balls around landmarks; of a point cloud without faces.
    """

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    distance: np.ndarray
    balls: int = 0

    def thinned(self) -> "DrawnScan":
        """At most `MAX_POINTS` of its points, with the faces between them, and all balls."""
        count = len(self.points) - self.balls
        if len(self.faces):
            of_balls = (self.faces >= count).any(axis=1)
            kept, faces = thin(self.points[:count], self.faces[~of_balls], MAX_POINTS)
            faces = np.concatenate([faces, self.faces[of_balls] - count + len(kept)])
        else:
            kept, faces = np.unique(np.linspace(0, count - 1, min(MAX_POINTS, count)).astype(int)), self.faces
        kept = np.append(kept, np.arange(count, len(self.points)))
        return DrawnScan(self.points[kept], self.normals[kept], faces, self.distance[kept], self.balls)

    def with_balls(self, centres: np.ndarray, distance: np.ndarray, ball: np.ndarray, faces: np.ndarray) -> "DrawnScan":
        """The scan with balls around landmarks.

        Args:
            centres: `(landmark, 3)`, mm.
            distance: of each from the rig's, `(landmark,)`, mm.
            ball: its corners `(corner, 3)` around the origin; `faces`: its triangles.
        """
        corners = (centres[:, None] + ball).reshape(-1, 3)
        starts = len(self.points) + len(ball) * np.arange(len(centres))
        more = (faces + starts[:, None, None]).reshape(-1, 3) if len(self.faces) else self.faces
        normals = np.tile(ball / np.linalg.norm(ball, axis=1, keepdims=True), (len(centres), 1))
        arrays = zip(self[:4], (corners, normals, more, distance.repeat(len(ball))))
        points, normals, faces, distance = (np.concatenate(both) for both in arrays)
        return DrawnScan(points, normals, faces, distance, len(corners))


class Scans(NamedTuple):
    """The scans of an animation.

    Attributes:
        drawn: the scan of a row; None where it has none.
        skin: the number of the recovered mesh's vertices, the first ones, without balls around landmarks: their distances scale
            the colours.
    """

    drawn: Callable[[int], DrawnScan | None]
    skin: int


NO_SCAN = DrawnScan(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros(0))


def drawn(scans: Scans, rows: Sequence[int]) -> list[DrawnScan]:
    """The scans of rows of an animation, thinned; without points where there is none."""
    found = (scans.drawn(row) for row in rows)
    return [NO_SCAN if scan is None else scan.thinned() for scan in found]


def scan_bytes(scans: Sequence[DrawnScan], middle: np.ndarray, step: float) -> tuple[list[tuple[int, int, int]], bytes]:
    """The numbers of points, faces and points of balls of each scan, and all scans for scene.js.

    Positions relative to `middle` and distances are integers in units of `step`, mm; all positions come first, then all
    distances, faces, and normals.
    """
    positions = [np.clip(((scan.points - middle) / step).round(), -FARTHEST, FARTHEST).astype("<i2") for scan in scans]
    steps = [np.minimum((scan.distance / step).round(), BEYOND - 1) for scan in scans]
    distances = [np.where(np.isnan(values), BEYOND, values).astype("<u2") for values in steps]
    faces = [scan.faces.astype("<u2") for scan in scans]
    normals = [(127 * scan.normals).round().astype("i1") for scan in scans]
    parts = [array.tobytes() for arrays in (positions, distances, faces, normals) for array in arrays]
    return [(len(scan.points), len(scan.faces), scan.balls) for scan in scans], b"".join(parts)
