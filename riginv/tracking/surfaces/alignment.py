"""Where a scan lies: rigid motion from the rig to it, without any guess, from one pose of the rig."""

import itertools
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.motion import Motion, fit_motion
from riginv.tracking.surfaces.triangles import TriangleMesh

POINTS = 600  # of either side
SCALES_MM = (40.0, 28.0, 20.0, 14.0, 10.0, 8.0, 6.0, 5.0, 4.0, 4.0, 3.0, 3.0, 3.0, 3.0)
POINT_STEPS = 5  # of these, from point to point; the others from point to plane
NORMALS_FROM = 3  # the step from which normals must agree
AGREE = 0.5  # cosine between two normals
WELL_MM, FAIRLY_MM = 5.0, 7.0  # robust mean distance up to which no turns are tried: of the same person, of somebody else
BETTER = 0.8  # times the distance that another try must come down to
ASIDE = 0.35  # of the rig's size, that its middle may lie beside that of the scan
ORIGIN = np.zeros(3)
WIDE_MM = 10.0  # at which the distance of one point is cut off


class Alignment(NamedTuple):
    """A rigid motion, and how well it brings the rig onto the scan.

    Attributes:
        motion: from the rig's frame to the scan's.
        distance_mm: mean distance of the scan's points from the rig, or of the rig's from the scan where that is less, none
            counted for more than `WIDE_MM`: either may show more than the other.
        turned: whether it was found only after turning the scan by right angles.
    """

    motion: Motion
    distance_mm: float
    turned: bool


class Aligner:
    """Aligns scans with one mesh, such as a pose of a rig.

    Args:
        mesh: the mesh.
        outer: the vertices that can be seen from outside, `(outer,)`.
        sampled: some of these, spread evenly, `(sample,)`.
        stability: how much each vertex counts, `(vertex,)`.
    """

    def __init__(self, mesh: TriangleMesh, outer: np.ndarray, sampled: np.ndarray, stability: np.ndarray) -> None:
        some = sampled[:: max(1, len(sampled) // POINTS)]
        self.points, self.normals, self.weights = mesh.points[some], mesh.normals[some], stability[some]
        self.vertices, self.vertex_normals = mesh.points[outer], mesh.normals[outer]
        self.vertex_weights = stability[outer] * ~mesh.border_points[outer]  # a scan may go on beyond the border
        self.tree = cKDTree(self.vertices)

    def align(self, target: Target, thorough: bool = False) -> Alignment:
        """From the scan's middle; where that fails, from places beside it, and from all turns by right angles.

        Args:
            thorough: whether places beside the middle are tried in any case.
        """
        scan = _Scan(target)
        best = self._settle(scan, self._centred(scan, np.eye(3)), False)
        tries = ((rotation, shift) for rotation in right_angles() for shift in self._shifts())
        for number, (rotation, shift) in enumerate(tries):
            turned = number >= len(self._shifts())
            if best.distance_mm <= (FAIRLY_MM if thorough else WELL_MM) and (turned or not thorough):
                break
            found = self._settle(scan, self._centred(scan, rotation, shift), turned)
            if found.distance_mm < (BETTER if turned else 1.0) * best.distance_mm:
                best = found
        return best

    def _shifts(self) -> list[np.ndarray]:
        """Ways from the middle of the rig to that of a scan that shows more or less of it, mm."""
        size = ASIDE * (self.vertices.max(axis=0) - self.vertices.min(axis=0)).max()
        return [np.zeros(3), *(sign * size * axis for axis in np.eye(3)[[2, 1, 0]] for sign in (1.0, -1.0))]

    def distance(self, target: Target, motion: Motion) -> float:
        """How far the scan's points lie from the rig under a motion, mm."""
        return self._distance(_Scan(target), motion)

    def _centred(self, scan: "_Scan", rotation: np.ndarray, shift: np.ndarray = ORIGIN) -> Motion:
        return Motion(rotation, scan.middle - rotation @ (np.median(self.vertices, axis=0) - shift))

    def _settle(self, scan: "_Scan", motion: Motion, turned: bool) -> Alignment:
        for step, scale in enumerate(SCALES_MM):
            ours, theirs, normals, weights = self._pairs(scan, motion, scale, step >= NORMALS_FROM)
            if weights.sum() < 1e-6:
                break
            if step < POINT_STEPS:
                motion = fit_motion(ours, theirs, weights)
            else:
                motion = _plane_step(ours, theirs, normals, weights, motion)
        return Alignment(motion, self._distance(scan, motion), turned)

    def _pairs(self, scan: "_Scan", motion: Motion, scale: float, by_normals: bool) -> tuple[np.ndarray, ...]:
        """Points of the rig and of the scan, the scan's normals, and weights."""
        there, turned = motion.apply(self.points), self.normals @ motion.rotation.T
        distance, nearest = scan.tree.query(there)
        alike = (turned * scan.all_normals[nearest]).sum(axis=1) > AGREE
        first = self.weights * ~scan.border[nearest] * (alike | (not by_normals)) / (1 + (distance / scale) ** 2) ** 2
        pairs = [(self.points, scan.all_points[nearest], scan.all_normals[nearest], first)]
        distance, nearest = self.tree.query(motion.undo(scan.points))
        alike = (self.vertex_normals[nearest] * motion.undo_direction(scan.normals)).sum(axis=1) > AGREE
        second = self.vertex_weights[nearest] * (alike | (not by_normals)) / (1 + (distance / scale) ** 2) ** 2
        pairs.append((self.vertices[nearest], scan.points, scan.normals, second))
        return tuple(np.concatenate(both) for both in zip(*pairs))

    def _distance(self, scan: "_Scan", motion: Motion) -> float:
        distance, nearest = self.tree.query(motion.undo(scan.points))
        alike = (self.vertex_normals[nearest] * motion.undo_direction(scan.normals)).sum(axis=1) > 0
        of_scan = np.minimum(np.where(alike, distance, WIDE_MM), WIDE_MM).mean()
        distance, nearest = scan.tree.query(motion.apply(self.points))
        alike = ((self.normals @ motion.rotation.T) * scan.all_normals[nearest]).sum(axis=1) > 0
        return float(min(of_scan, np.minimum(np.where(alike, distance, WIDE_MM), WIDE_MM).mean()))


class _Scan:
    """A scan as points."""

    def __init__(self, target: Target) -> None:
        surface, every = target.surface, max(1, len(target.points) // POINTS)
        self.points, self.normals = target.points[::every], target.normals[::every]
        self.all_points, self.all_normals = surface.points, surface.normals
        self.border = surface.border_points
        self.tree = cKDTree(self.all_points)
        self.middle = np.median(target.points, axis=0)


def _plane_step(ours: np.ndarray, theirs: np.ndarray, normals: np.ndarray, weights: np.ndarray, motion: Motion) -> Motion:
    """One step of weighted least squares of the distances along the scan's normals."""
    there = motion.apply(ours)
    centre = np.average(there, axis=0, weights=weights)
    rows = np.concatenate([np.cross(there - centre, normals), normals], axis=1)
    residual = ((theirs - there) * normals).sum(axis=1)
    square = rows.T @ (weights[:, None] * rows)
    change = np.linalg.solve(square + 1e-6 * np.trace(square) * np.eye(6), rows.T @ (weights * residual))
    small = Rotation.from_rotvec(change[:3]).as_matrix()
    return Motion(small @ motion.rotation, small @ (motion.shift - centre) + centre + change[3:])


def right_angles() -> list[np.ndarray]:
    """The 24 rotations that bring axes onto axes; the first changes nothing."""
    found = [np.eye(3)]
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0 and not np.array_equal(matrix, np.eye(3)):
                found.append(matrix)
    return found
