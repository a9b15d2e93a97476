"""Scans made from meshes whose every vertex is known: other topology, what cameras see, noise, holes, motion.

Only tests and benchmarks use this; it needs `fast-simplification` (`pip install 'riginv[test]'`).
"""

from dataclasses import dataclass

import fast_simplification
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

CAMERA_DISTANCE_MM = 600.0
AZIMUTHS, ELEVATIONS = np.radians([-60, -36, -12, 12, 36, 60]), np.radians([-30, -10, 10, 30])


@dataclass(frozen=True)
class Degradation:
    """What is done to a scan.

    Attributes:
        faces_kept: the fraction of the mesh's faces that decimation leaves.
        visible_only: keep only faces that one of 24 cameras before the face sees.
        noise_mm: standard deviation of each coordinate.
        holes: the fraction of the faces that lie in balls which are cut out.
        degrees, shift_mm: of the rigid motion, about a random axis and in a random direction.
    """

    faces_kept: float = 0.4
    visible_only: bool = True
    noise_mm: float = 0.0
    holes: float = 0.0
    degrees: float = 0.0
    shift_mm: float = 0.0


def make_scan(
    vertices: np.ndarray, faces: np.ndarray, how: Degradation, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A scan of a mesh: vertices `(vertex, 3)` and faces `(face, 3)`, none of whose vertices is one of the mesh.

    Midpoints are added, every original vertex slides along an edge, and quadric decimation follows.
    """
    points, triangles = resampled(vertices, faces, int(how.faces_kept * len(faces)), rng)
    if how.visible_only:
        triangles = triangles[seen(points, triangles)]
    points, triangles = compacted(points, triangles)
    if how.holes:
        triangles = with_holes(points, triangles, how.holes, rng)
        points, triangles = compacted(points, triangles)
    points = points + rng.normal(0, how.noise_mm, points.shape) if how.noise_mm else points
    if how.degrees or how.shift_mm:
        axis, direction = rng.normal(size=(2, 3))
        rotation = Rotation.from_rotvec(np.radians(how.degrees) * axis / np.linalg.norm(axis)).as_matrix()
        centre = vertices.mean(0)
        points = (points - centre) @ rotation.T + centre + how.shift_mm * direction / np.linalg.norm(direction)
    return points.astype(np.float32), triangles.astype(np.int64)


def resampled(vertices: np.ndarray, faces: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The same surface with `count` other triangles."""
    points, triangles = trimesh.remesh.subdivide(vertices, faces)
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[rng.permutation(len(edges))]
    original = edges[edges[:, 0] < len(vertices)]  # subdivision puts the original vertices first
    first = np.unique(original[:, 0], return_index=True)[1]
    start, end = original[first].T
    amount = rng.uniform(0.2, 0.8, (len(start), 1))
    points = points.copy()
    points[start] += amount * (points[end] - points[start])
    return fast_simplification.simplify(points.astype(np.float32), triangles.astype(np.int32), target_count=count)


def seen(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Whether each face `(face,)` is seen by one of 24 cameras on a grid before the face (+z)."""
    mesh = trimesh.Trimesh(points, faces, process=False)
    centres, normals, found = mesh.triangles_center, mesh.face_normals, np.zeros(len(faces), bool)
    middle = (points.min(0) + points.max(0)) / 2
    for azimuth in AZIMUTHS:
        for elevation in ELEVATIONS:
            towards = [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)]
            ray = middle + CAMERA_DISTANCE_MM * np.array(towards) - centres
            ray /= np.linalg.norm(ray, axis=1, keepdims=True)
            facing = ((normals * ray).sum(1) > 0.05) & ~found
            hidden = mesh.ray.intersects_any(centres[facing] + 1e-2 * normals[facing], ray[facing])
            found[np.flatnonzero(facing)[~hidden]] = True
    return found


def with_holes(points: np.ndarray, faces: np.ndarray, fraction: float, rng: np.random.Generator) -> np.ndarray:
    """The faces without those in balls around random places, until `fraction` of them are gone."""
    centres, gone = points[faces].mean(1), np.zeros(len(faces), bool)
    while gone.mean() < fraction:
        ball = np.linalg.norm(centres - centres[rng.integers(len(centres))], axis=1) < rng.uniform(6, 14)
        gone |= ball
    return faces[~gone]


def compacted(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Only the vertices that faces use."""
    used, renumbered = np.unique(faces, return_inverse=True)
    return points[used], renumbered.reshape(-1, 3)
