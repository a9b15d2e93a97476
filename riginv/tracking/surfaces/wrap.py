"""Non-rigid registration of a mesh to a scan.

First a similarity by closest points, then vertex displacements of decreasing stiffness (nonrigid ICP after Amberg, Romdhani and
Vetter, 2007, with a Laplacian in place of affine maps).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from riginv.errors import InputError
from riginv.tracking.surfaces.alignment import Aligner
from riginv.tracking.surfaces.landmarks import Landmarks
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.motion import Motion, fit_motion
from riginv.tracking.surfaces.rig_surface import EXPOSED, exposure, farthest_points
from riginv.tracking.surfaces.triangles import Hits, Surface, TriangleMesh, border_edges

SAMPLES = 1500
FOLLOWED = 12  # skin vertices that a vertex of a loose part, such as an eyeball, follows
TOO_FAR_MM = 8.0  # robust mean distance beyond which a scan does not match the mesh
WIDE_MM, SCALE_MM = 20.0, 5.0  # least scale of Geman and McClure's weights, at first and in the end


@dataclass(frozen=True)
class WrapSettings:
    """Settings of the registration.

    Attributes:
        similarity_rounds: iterations of the similarity.
        stiffness: of each iteration of the displacements, relative to the data term of one vertex; decreasing.
        normal_fraction: weight of displacements along the scan's normal; the rest is sliding.
        degrees: angle between the normals of a vertex and of the scan, beyond which they do not match.
        usable_mm: distance up to which a vertex lies on the scan.
    """

    similarity_rounds: int = 25
    stiffness: tuple[float, ...] = (100.0, 50.0, 25.0, 12.0, 6.0, 3.0, 1.5, 0.8, 0.4, 0.2)
    normal_fraction: float = 0.9
    degrees: float = 60.0
    usable_mm: float = 1.5


class Wrapped(NamedTuple):
    """A mesh registered to a scan.

    Attributes:
        vertices: in the scan's frame, mm, `(vertex, 3)`.
        local: in the mesh's frame, without the similarity, `(vertex, 3)`.
        scale: of the scan relative to the mesh.
        motion: from the scaled mesh's frame to the scan's.
        distance_mm: of each vertex from the scan, `(vertex,)`; NaN where it does not lie on it.
        usable: the fraction of the outer skin's vertices that lie on the scan.
    """

    vertices: np.ndarray
    local: np.ndarray
    scale: float
    motion: Motion
    distance_mm: np.ndarray
    usable: float


def wrap(
    rest: np.ndarray,
    faces: np.ndarray,
    scan: Surface,
    settings: WrapSettings | None = None,
    landmarks: Landmarks | None = None,
) -> Wrapped:
    """Register a mesh to a scan.

    Args:
        rest: vertices of the mesh `(vertex, 3)`, mm.
        faces: its triangles `(face, 3)`.
        scan: in mm, in any pose and size.
        landmarks: of the scan; None: none.

    Raises:
        InputError: the scan cannot be brought onto the mesh.
    """
    settings, rest = settings or WrapSettings(), rest.astype(np.float64)
    outer = np.flatnonzero(exposure(rest, faces) > EXPOSED)
    border = border_edges(faces)
    scale, motion = _similarity(rest, faces, outer, scan, settings, landmarks)
    skin = skin_component(rest, faces, outer)
    moving, displacement = np.flatnonzero(skin), np.zeros_like(rest)
    attracted = np.zeros(len(rest), bool)
    attracted[outer] = True
    smoothness = smoothness_matrix(faces, skin)
    least = np.geomspace(WIDE_MM, SCALE_MM, len(settings.stiffness))
    for stiffness, least_mm in zip(settings.stiffness, least):
        mesh = TriangleMesh(rest + displacement, faces, border)
        hits, weights = _attract(mesh, moving, scan, motion, scale, settings, float(least_mm))
        weights = weights * attracted[moving]
        towards = motion.undo(hits.points) / scale - mesh.points[moving]
        normals = motion.undo_direction(hits.normals)
        along = (towards * normals).sum(axis=1, keepdims=True) * normals
        aim = displacement[moving] + along + (1 - settings.normal_fraction) * (towards - along)
        matrix, right = scipy.sparse.diags_array(weights) + stiffness * smoothness, weights[:, None] * aim
        if landmarks is not None:
            weight = landmarks.weight * stiffness**2 / settings.stiffness[0]
            carriers = _carriers(landmarks, skin)
            away = motion.undo(landmarks.points) / scale - landmarks.on(mesh.points)
            matrix = matrix + weight * carriers.T @ carriers
            right = right + weight * carriers.T @ (carriers @ displacement[moving] + away)
        factor = scipy.sparse.linalg.splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        displacement[moving] = factor.solve(right)
        displacement = with_loose_parts(rest, faces, skin, displacement)
    local = rest + displacement
    hits, weights = _attract(TriangleMesh(local, faces, border), np.arange(len(rest)), scan, motion, scale, settings)
    distance = np.where((weights > 0) & (hits.distance < settings.usable_mm) & attracted, hits.distance, np.nan)
    usable = float(np.isfinite(distance[attracted & skin]).mean())
    return Wrapped(motion.apply(scale * local), local, scale, motion, distance, usable)


def _attract(
    mesh: TriangleMesh,
    some: np.ndarray,
    scan: Surface,
    motion: Motion,
    scale: float,
    settings: WrapSettings,
    least_mm: float = SCALE_MM,
) -> tuple[Hits, np.ndarray]:
    """Closest points of a scan to some vertices, in the scan's frame, and their weights."""
    hits = scan.closest(motion.apply(scale * mesh.points[some]))
    cosine = (mesh.normals[some] @ motion.rotation.T * hits.normals).sum(axis=1)
    typical = max(3 * float(np.median(hits.distance)), least_mm)
    good = (cosine > np.cos(np.radians(settings.degrees))) & ~hits.on_border
    return hits, np.where(good, 1 / (1 + (hits.distance / typical) ** 2) ** 2, 0.0)


def _carriers(landmarks: Landmarks, skin: np.ndarray) -> "scipy.sparse.csr_array":
    """The weights `(landmark, skin vertex)` that make landmarks of vertices; those that are not on the skin have none."""
    corners, weights = landmarks.placement.corners.numpy(), landmarks.placement.barycentric.double().numpy()
    rows = np.repeat(np.arange(len(corners)), 3)
    every = scipy.sparse.csr_array((weights.reshape(-1), (rows, corners.reshape(-1))), shape=(len(corners), len(skin)))
    on_skin = scipy.sparse.diags_array(skin[corners].all(axis=1).astype(float))
    return (on_skin @ every).tocsr()[:, skin]


def _similarity(
    rest: np.ndarray,
    faces: np.ndarray,
    outer: np.ndarray,
    scan: Surface,
    settings: WrapSettings,
    landmarks: Landmarks | None,
) -> tuple[float, Motion]:
    mesh = TriangleMesh(rest, faces)
    sampled = outer[farthest_points(rest[outer], SAMPLES)]
    aligner, target = Aligner(mesh, outer, sampled, np.ones(len(rest))), Target.of(scan, SAMPLES, landmarks=landmarks)
    start = aligner.align(target, thorough=True)
    aligner.refuse_inwards(target, start, "the normals of the scan")
    if start.distance_mm > TOO_FAR_MM:
        raise InputError(
            f"the scan cannot be brought onto the mesh: its points stay {start.distance_mm:.1f} mm away and more: is it the "
            f"same part of a person, in the unit that was read, with normals that point outwards?"
        )
    scale, motion, target = 1.0, start.motion, Target.of(scan, SAMPLES)
    for number in range(settings.similarity_rounds):
        hits, weights = _attract(mesh, sampled, scan, motion, scale, settings)
        mesh_points, scan_points, normals = motion.apply(scale * rest[sampled]), hits.points, hits.normals
        back = mesh.closest(motion.undo(target.points) / scale)
        back_points = motion.apply(scale * back.points)
        cosine = (back.normals @ motion.rotation.T * target.normals).sum(axis=1)
        good = (cosine > np.cos(np.radians(settings.degrees))) & ~back.on_border
        distance = np.linalg.norm(back_points - target.points, axis=1)
        further = np.where(good, 1 / (1 + (distance / SCALE_MM) ** 2) ** 2, 0.0)
        pairs = ((mesh_points, back_points), (scan_points, target.points), (normals, target.normals), (weights, further))
        joined = [np.concatenate(parts) for parts in pairs]
        if landmarks is not None:
            fraction = 1 - number / settings.similarity_rounds
            joined = _with_landmarks(joined, landmarks, motion.apply(scale * landmarks.on(rest)), fraction)
        scale, motion = _similarity_step(joined[0], joined[1], joined[2], joined[3], scale, motion)
    return scale, motion


def _with_landmarks(joined: list[np.ndarray], landmarks: Landmarks, ours: np.ndarray, fraction: float) -> list[np.ndarray]:
    """Points of mesh and scan, normals and weights of pairs, with those of landmarks `ours` `(landmark, 3)` along each axis.

    Args:
        fraction: of the schedule that remains: the weight of the landmarks falls with it.
    """
    count = len(ours)
    weights = np.full(3 * count, landmarks.weight_at(WIDE_MM * fraction) * joined[3].sum() / count)
    more = (np.repeat(ours, 3, axis=0), np.repeat(landmarks.points, 3, axis=0), np.tile(np.eye(3), (count, 1)), weights)
    return [np.concatenate(parts) for parts in zip(joined, more)]


def _similarity_step(
    mesh_points: np.ndarray, scan_points: np.ndarray, normals: np.ndarray, weights: np.ndarray, scale: float, motion: Motion
) -> tuple[float, Motion]:
    """One step of weighted least squares of distances along normals, in rotation, shift and scale."""
    centre = np.average(mesh_points, axis=0, weights=weights + 1e-12)
    offset = mesh_points - centre
    rows = np.concatenate([np.cross(offset, normals), normals, (offset * normals).sum(axis=1, keepdims=True)], axis=1)
    square = rows.T @ (weights[:, None] * rows)
    change = np.linalg.solve(
        square + 1e-6 * np.diag(square.diagonal()), rows.T @ (weights * ((scan_points - mesh_points) * normals).sum(1))
    )
    small, factor = scipy.spatial.transform.Rotation.from_rotvec(change[:3]).as_matrix(), float(np.exp(change[6]))
    return scale * factor, Motion(small @ motion.rotation, factor * small @ (motion.shift - centre) + centre + change[3:6])


def skin_component(rest: np.ndarray, faces: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Whether each vertex is in the connected component with most outer vertices, `(vertex,)`."""
    part = connected_parts(faces, len(rest))
    return part == np.bincount(part[outer]).argmax()


def connected_parts(faces: np.ndarray, count: int) -> np.ndarray:
    """The connected component that each of `count` vertices is in, as a number from 0, `(vertex,)`."""
    return scipy.sparse.csgraph.connected_components(_adjacency(faces, count), directed=False)[1]


def smoothness_matrix(faces: np.ndarray, skin: np.ndarray) -> "scipy.sparse.csc_array":
    """The smoothness matrix of skin displacements: half the squared edges plus five times the squared Laplacian."""
    adjacency = _adjacency(faces, len(skin))[skin][:, skin]
    degrees = adjacency.sum(axis=1)
    edges = scipy.sparse.diags_array(degrees) - adjacency
    laplacian = scipy.sparse.diags_array(1 / np.maximum(degrees, 1)) @ edges
    return (0.5 * edges + 5.0 * laplacian.T @ laplacian).tocsc()


def _adjacency(faces: np.ndarray, count: int) -> "scipy.sparse.csr_array":
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    matrix = scipy.sparse.csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    matrix = matrix + matrix.T
    matrix.data[:] = 1.0
    return matrix.tocsr()


def with_loose_parts(rest: np.ndarray, faces: np.ndarray, skin: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Displacements where loose parts, such as eyeballs and teeth, follow the nearby skin rigidly."""
    if skin.all():
        return displacement
    result = displacement.copy()
    part = connected_parts(faces, len(rest))
    on_skin = np.flatnonzero(skin)
    tree = scipy.spatial.cKDTree(rest[on_skin])
    for number in range(part.max() + 1):
        members = np.flatnonzero(part == number)
        if skin[members[0]]:
            continue
        near = on_skin[tree.query(rest[members], k=min(FOLLOWED, len(on_skin)))[1].reshape(-1)]
        motion = fit_motion(rest[near], rest[near] + displacement[near], np.ones(len(near)))
        result[members] = motion.apply(rest[members]) - rest[members]
    return result
