"""Global rigid alignment of a rig's pose to a scan, without a start."""

import itertools
from typing import NamedTuple

import numpy as np
import scipy

from riginv.errors import InputError
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.motion import Motion, fit_motion
from riginv.tracking.surfaces.triangles import TriangleMesh

POINTS = 600  # of the rig, and of the scan
SCALES_MM = (40.0, 28.0, 20.0, 14.0, 10.0, 8.0, 6.0, 5.0, 4.0, 4.0, 3.0, 3.0, 3.0, 3.0)
POINT_STEPS = 5  # of these are point to point, the others point to plane
NORMALS_FROM = 3  # the step from which normals must agree
MIN_COSINE = 0.5  # between two normals that agree
GOOD_MM, FAIR_MM = 5.0, 7.0  # robust mean distance of a good alignment: of the same person, of another person
BETTER = 0.8  # factor of the distance that a rotated start must reach
SHIFT = 0.35  # of the rig's size, for starts beside the scan's centre
ORIGIN = np.zeros(3)
MAX_MM = 10.0  # distances are clipped


class Alignment(NamedTuple):
    """A rigid motion from the rig to the scan, and its quality.

    Attributes:
        motion: from the rig's frame to the scan's.
        distance_mm: mean distance, clipped at `MAX_MM`, of the scan's points from the rig or of the rig's from the scan,
            whichever is less: either may cover more than the other.
        turned: whether it was found only after a rotation by right angles.
    """

    motion: Motion
    distance_mm: float
    turned: bool


class Aligner:
    """Aligns scans with one mesh, such as a pose of a rig.

    Args:
        mesh: the mesh.
        outer: indices of vertices that are visible from outside, `(outer,)`.
        sampled: evenly spread ones of these, `(sample,)`.
        stability: weight of each vertex, `(vertex,)`.
    """

    def __init__(self, mesh: TriangleMesh, outer: np.ndarray, sampled: np.ndarray, stability: np.ndarray) -> None:
        some = sampled[:: max(1, len(sampled) // POINTS)]
        self.points, self.normals, self.weights = mesh.points[some], mesh.normals[some], stability[some]
        self.vertices, self.vertex_normals = mesh.points[outer], mesh.normals[outer]
        self.vertex_weights = stability[outer] * ~mesh.border_points[outer]  # a scan may extend beyond the border
        self.tree, self.all_vertices = scipy.spatial.cKDTree(self.vertices), mesh.points

    def align(self, target: Target, thorough: bool = False) -> Alignment:
        """Align from the scan's centre; if that fails, from starts beside it, and from all rotations by right angles.

        Where landmarks determine an alignment that is good, it is taken, and where it is not, it is one of the starts.

        Args:
            thorough: try starts beside the centre in any case.
        """
        scan = _Scan(target)
        by_landmarks = self._by_landmarks(scan, target)
        if by_landmarks is not None and by_landmarks.distance_mm <= GOOD_MM:
            return by_landmarks
        best = self._refine(scan, self._centred(scan, np.eye(3)), False)
        if by_landmarks is not None and by_landmarks.distance_mm < best.distance_mm:
            best = by_landmarks
        tries = ((rotation, shift) for rotation in right_angles() for shift in self._shifts())
        for number, (rotation, shift) in enumerate(tries):
            turned = number >= len(self._shifts())
            if best.distance_mm <= (FAIR_MM if thorough else GOOD_MM) and (turned or not thorough):
                break
            found = self._refine(scan, self._centred(scan, rotation, shift), turned)
            if found.distance_mm < (BETTER if turned else 1.0) * best.distance_mm:
                best = found
        return best

    def from_centre(self, target: Target) -> Alignment:
        """The alignment from the scan's centre alone, upright as it is read: fast, and enough to compare readings of a scan."""
        scan = _Scan(target)
        return self._refine(scan, self._centred(scan, np.eye(3)), False)

    def refuse_inwards(self, target: Target, aligned: Alignment, normals: str) -> None:
        """Raise InputError where a scan that is not aligned well fits with its `normals` reversed, which are so named."""
        if aligned.distance_mm <= FAIR_MM:
            return
        other = self.align(Target(target.surface.reversed(), target.points, -target.normals))
        if other.distance_mm < min(GOOD_MM, BETTER * aligned.distance_mm):
            raise InputError(
                f"{normals} point inwards: reversed it fits the mesh; flip them (the order of each face's corners), and export "
                f"it again"
            )

    def _by_landmarks(self, scan: "_Scan", target: Target) -> Alignment | None:
        """The alignment of the landmarks, or that after refinement, if it is better."""
        motion = None if target.landmarks is None else target.landmarks.motion(self.all_vertices)
        if motion is None:
            return None
        return min(Alignment(motion, self._distance(scan, motion), False), self._refine(scan, motion, False), key=_distance_mm)

    def _shifts(self) -> list[np.ndarray]:
        """Offsets of the rig's centre from the scan's, mm, for scans that show more or less of it."""
        size = SHIFT * (self.vertices.max(axis=0) - self.vertices.min(axis=0)).max()
        return [np.zeros(3), *(sign * size * axis for axis in np.eye(3)[[2, 1, 0]] for sign in (1.0, -1.0))]

    def distance(self, target: Target, motion: Motion) -> float:
        """As `Alignment.distance_mm`, under a given motion."""
        return self._distance(_Scan(target), motion)

    def _centred(self, scan: "_Scan", rotation: np.ndarray, shift: np.ndarray = ORIGIN) -> Motion:
        return Motion(rotation, scan.middle - rotation @ (np.median(self.vertices, axis=0) - shift))

    def _refine(self, scan: "_Scan", motion: Motion, turned: bool) -> Alignment:
        for step, scale in enumerate(SCALES_MM):
            source, target, normals, weights = self._pairs(scan, motion, scale, step >= NORMALS_FROM)
            if weights.sum() < 1e-6:
                break
            if step < POINT_STEPS:
                motion = fit_motion(source, target, weights)
            else:
                motion = _plane_step(source, target, normals, weights, motion)
        return Alignment(motion, self._distance(scan, motion), turned)

    def _pairs(self, scan: "_Scan", motion: Motion, scale: float, by_normals: bool) -> list[np.ndarray]:
        """Points of the rig and of the scan, the scan's normals, and weights."""
        moved, normals = motion.apply(self.points), self.normals @ motion.rotation.T
        distance, nearest = scan.tree.query(moved)
        agree = (normals * scan.all_normals[nearest]).sum(axis=1) > MIN_COSINE
        first = self.weights * ~scan.border[nearest] * (agree | (not by_normals)) / (1 + (distance / scale) ** 2) ** 2
        pairs = [(self.points, scan.all_points[nearest], scan.all_normals[nearest], first)]
        distance, nearest = self.tree.query(motion.undo(scan.points))
        agree = (self.vertex_normals[nearest] * motion.undo_direction(scan.normals)).sum(axis=1) > MIN_COSINE
        second = self.vertex_weights[nearest] * (agree | (not by_normals)) / (1 + (distance / scale) ** 2) ** 2
        pairs.append((self.vertices[nearest], scan.points, scan.normals, second))
        return [np.concatenate(both) for both in zip(*pairs)]

    def _distance(self, scan: "_Scan", motion: Motion) -> float:
        distance, nearest = self.tree.query(motion.undo(scan.points))
        agree = (self.vertex_normals[nearest] * motion.undo_direction(scan.normals)).sum(axis=1) > 0
        of_scan = np.minimum(np.where(agree, distance, MAX_MM), MAX_MM).mean()
        distance, nearest = scan.tree.query(motion.apply(self.points))
        agree = ((self.normals @ motion.rotation.T) * scan.all_normals[nearest]).sum(axis=1) > 0
        return float(min(of_scan, np.minimum(np.where(agree, distance, MAX_MM), MAX_MM).mean()))


def _distance_mm(alignment: Alignment) -> float:
    return alignment.distance_mm


class _Scan:
    """A scan as points."""

    def __init__(self, target: Target) -> None:
        surface, every = target.surface, max(1, len(target.points) // POINTS)
        self.points, self.normals = target.points[::every], target.normals[::every]
        self.all_points, self.all_normals = surface.points, surface.normals
        self.border = surface.border_points
        self.tree = scipy.spatial.cKDTree(self.all_points)
        self.middle = np.median(target.points, axis=0)


def _plane_step(source: np.ndarray, target: np.ndarray, normals: np.ndarray, weights: np.ndarray, motion: Motion) -> Motion:
    """One step of weighted least squares of distances along the scan's normals."""
    moved = motion.apply(source)
    centre = np.average(moved, axis=0, weights=weights)
    rows = np.concatenate([np.cross(moved - centre, normals), normals], axis=1)
    residual = ((target - moved) * normals).sum(axis=1)
    square = rows.T @ (weights[:, None] * rows)
    change = np.linalg.solve(square + 1e-6 * np.trace(square) * np.eye(6), rows.T @ (weights * residual))
    small = scipy.spatial.transform.Rotation.from_rotvec(change[:3]).as_matrix()
    return Motion(small @ motion.rotation, small @ (motion.shift - centre) + centre + change[3:])


def right_angles() -> list[np.ndarray]:
    """The 24 rotations by right angles, the identity first."""
    found = [np.eye(3)]
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0 and not np.array_equal(matrix, np.eye(3)):
                found.append(matrix)
    return found
