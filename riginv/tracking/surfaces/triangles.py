"""Closest points on surfaces: triangle meshes, searched with libigl, and point clouds with normals."""

from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy

if TYPE_CHECKING:
    import igl

EDGE = 1e-4  # the barycentric coordinate below which a point lies on an edge
NEIGHBOURS = 16  # points that a normal is estimated from
REUSE_MM = 1.0  # displacement of a mesh's points up to which its search tree is used again
ONE_SIDED = 0.35  # distance of a point from the mean of its neighbours, relative to the farthest, at the border of a cloud


class Hits(NamedTuple):
    """Closest points of a surface to query points.

    Attributes:
        points: `(query, 3)`, mm.
        normals: `(query, 3)`, of unit length.
        distance: `(query,)`, mm.
        on_border: whether the closest point lies on the border of the surface, `(query,)`.
        corners: indices of the vertices around each point, `(query, corner)`.
        barycentric: its weights on these, `(query, corner)`.
    """

    points: np.ndarray
    normals: np.ndarray
    distance: np.ndarray
    on_border: np.ndarray
    corners: np.ndarray
    barycentric: np.ndarray


class Surface(ABC):
    """A surface with closest points.

    Attributes:
        points: `(point, 3)`, mm.
        normals: of each point, `(point, 3)`, of unit length.
    """

    points: np.ndarray
    normals: np.ndarray

    @property
    @abstractmethod
    def border_points(self) -> np.ndarray:
        """Whether each point is at the border of the surface, `(point,)`."""

    @abstractmethod
    def closest(self, queries: np.ndarray) -> Hits:
        """The closest point of the surface to each query `(query, 3)`."""

    @abstractmethod
    def reversed(self) -> "Surface":
        """The surface with its other side out."""

    @abstractmethod
    def samples(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """About `count` points `(sample, 3)` spread over the surface by area, and their normals."""


class TriangleMesh(Surface):
    """A triangle mesh.

    Args:
        points: `(point, 3)`, mm.
        faces: `(face, 3)`.
        border, around: `border_edges(faces)` and `faces_around(faces, len(points))`, if they are known already.
        near: a mesh of the same faces, whose search tree is used again if no point is further than `REUSE_MM` from there.
    """

    def __init__(
        self,
        points: np.ndarray,
        faces: np.ndarray,
        border: np.ndarray | None = None,
        around: "scipy.sparse.csr_array | None" = None,
        near: "TriangleMesh | None" = None,
    ) -> None:
        self.points = np.ascontiguousarray(points, np.float64)
        self.faces = np.ascontiguousarray(faces, np.int64)
        self.border = border_edges(self.faces) if border is None else border
        corners = self.points[self.faces]
        crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.areas = 0.5 * np.linalg.norm(crossed, axis=1)
        self.normals = unit((faces_around(self.faces, len(self.points)) if around is None else around) @ crossed)
        base: TriangleMesh | None = near and (near._base or near)
        is_near = base is not None and ((self.points - base.points) ** 2).sum(axis=1).max() < REUSE_MM**2
        self._base: TriangleMesh | None = base if is_near else None

    def reversed(self) -> "TriangleMesh":
        return TriangleMesh(self.points, self.faces[:, ::-1])

    @cached_property
    def border_points(self) -> np.ndarray:
        """Whether each point is at the border, `(point,)`."""
        found = np.zeros(len(self.points), bool)
        for corner in range(3):
            ends = self.faces[self.border[:, corner]]
            found[ends[:, (corner + 1) % 3]] = found[ends[:, (corner + 2) % 3]] = True
        return found

    @cached_property
    def _tree(self) -> "igl.AABB":
        import igl  # a third of a second, with SciPy's sparse matrices

        tree = igl.AABB()
        tree.init(self.points, self.faces)
        return tree

    def _find(self, queries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The faces of the closest points, and their barycentric coordinates."""
        _, face, found = self._tree.squared_distance(self.points, self.faces, queries)
        face = face.reshape(-1)
        return face, barycentric(found, self.points[self.faces[face]])

    def closest(self, queries: np.ndarray) -> Hits:
        queries = np.ascontiguousarray(queries, np.float64)
        if self._base is None:
            face, weights = self._find(queries)
        else:  # queries are moved as their closest points of the other mesh are away from here
            face, weights = self._base._find(queries)
            moved = (weights[..., None] * (self.points - self._base.points)[self.faces[face]]).sum(axis=1)
            face, weights = self._base._find(queries - moved)
        corners = self.faces[face]
        found = (weights[..., None] * self.points[corners]).sum(axis=1)
        normals = unit((weights[..., None] * self.normals[corners]).sum(axis=1))
        on_edge = weights < EDGE
        at_corner = on_edge.sum(axis=1) == 2
        nearest = corners[np.arange(len(corners)), weights.argmax(axis=1)]
        on_border = (on_edge & self.border[face]).any(axis=1) | (at_corner & self.border_points[nearest])
        return Hits(found, normals, np.linalg.norm(queries - found, axis=1), on_border, corners, weights)

    def samples(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        face, weights = self.sample_barycentric(count, seed)
        corners = self.faces[face]
        points = (weights[..., None] * self.points[corners]).sum(axis=1)
        return points, unit((weights[..., None] * self.normals[corners]).sum(axis=1))

    def sample_barycentric(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Triangles `(sample,)` and barycentric coordinates `(sample, 3)`, stratified by area."""
        rng = np.random.default_rng(seed)
        total = np.cumsum(self.areas)
        area = (np.arange(count) + rng.random(count)) / count * total[-1]
        face = np.minimum(np.searchsorted(total, area), len(total) - 1)
        root, along = np.sqrt(rng.random(count)), rng.random(count)
        return face, np.stack([1 - root, root * (1 - along), root * along], axis=1)


class PointCloud(Surface):
    """Points with normals; missing normals are estimated and oriented outwards.

    Args:
        points: `(point, 3)`, mm.
        normals: `(point, 3)`, or None.
    """

    def __init__(self, points: np.ndarray, normals: np.ndarray | None = None) -> None:
        self.points = np.ascontiguousarray(points, np.float64)
        self.tree = scipy.spatial.cKDTree(self.points)
        distance, near = self.tree.query(self.points, k=min(NEIGHBOURS, len(points)))
        self.spacing = float(np.median(distance[:, 1])) if len(points) > 1 else 1.0
        self.normals = self._estimated(near) if normals is None else unit(np.asarray(normals, np.float64))
        offset = np.linalg.norm(self.points[near].mean(axis=1) - self.points, axis=1)
        self._border_points = offset > ONE_SIDED * distance[:, -1]

    def reversed(self) -> "PointCloud":
        return PointCloud(self.points, -self.normals)

    @property
    def border_points(self) -> np.ndarray:
        return self._border_points

    def _estimated(self, near: np.ndarray) -> np.ndarray:
        local = self.points[near] - self.points[near].mean(axis=1, keepdims=True)
        normals = np.linalg.eigh(local.transpose(0, 2, 1) @ local)[1][:, :, 0]
        outward = self.points - self.points.mean(axis=0)
        return oriented(normals, near, (normals * outward).sum(axis=1))

    def closest(self, queries: np.ndarray) -> Hits:
        _, nearest = self.tree.query(queries)
        normals = self.normals[nearest]
        height = ((queries - self.points[nearest]) * normals).sum(axis=1, keepdims=True)
        tangent = queries - height * normals - self.points[nearest]
        factor = np.minimum(1.0, self.spacing / np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12))
        points = self.points[nearest] + factor * tangent  # on the tangent plane, at most a typical spacing away
        corners, weights = nearest[:, None], np.ones((len(nearest), 1))
        return Hits(points, normals, np.linalg.norm(queries - points, axis=1), self.border_points[nearest], corners, weights)

    def samples(self, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        if count >= len(self.points):
            return self.points, self.normals
        chosen = np.sort(np.random.default_rng(seed).choice(len(self.points), count, replace=False))
        return self.points[chosen], self.normals[chosen]


def oriented(normals: np.ndarray, near: np.ndarray, outward: np.ndarray, rounds: int = 10) -> np.ndarray:
    """Normals `(point, 3)` flipped where `outward` `(point,)` is negative, by majority of neighbours `(point, neighbour)`."""
    signs = np.where(outward < 0, -1.0, 1.0)
    agreement = np.einsum("pc,pnc->pn", normals, normals[near])
    for _ in range(rounds):
        signs = np.where((agreement * signs[near]).sum(axis=1) < 0, -1.0, 1.0)
    return normals * signs[:, None]


def border_edges(faces: np.ndarray) -> np.ndarray:
    """Whether the edge opposite each corner belongs to one triangle only, `(face, 3)`."""
    edges = np.sort(np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).reshape(-1, 2), axis=1)
    key = edges[:, 0] * (int(faces.max(initial=0)) + 1) + edges[:, 1]
    _, inverse, counts = np.unique(key, return_inverse=True, return_counts=True)
    return (counts[inverse.reshape(-1)] == 1).reshape(-1, 3)


def barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric coordinates `(point, 3)` of points within triangles `(point, 3, 3)`."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    inside = points - corners[:, 0]
    a, b, c = ((x * y).sum(axis=1) for x, y in ((first, first), (first, second), (second, second)))
    d, e = (inside * first).sum(axis=1), (inside * second).sum(axis=1)
    determinant = np.maximum(a * c - b * b, 1e-24)
    v, w = (c * d - b * e) / determinant, (a * e - b * d) / determinant
    weights = np.clip(np.stack([1 - v - w, v, w], axis=1), 0, 1)
    return weights / weights.sum(axis=1, keepdims=True)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors `(vector, 3)` normalised; zero vectors stay zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def faces_around(faces: np.ndarray, points: int) -> "scipy.sparse.csr_array":
    """A matrix `(point, face)` that sums values of the faces around each point."""
    rows, columns = faces.reshape(-1), np.repeat(np.arange(len(faces)), 3)
    return scipy.sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(points, len(faces)))
