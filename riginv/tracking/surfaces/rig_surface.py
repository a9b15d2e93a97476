"""A rig's mesh as a surface: poses, samples, and derivatives of its points along normals."""

import copy
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.rig.interface import LinearRig
from riginv.rig.jacobian import Jacobian
from riginv.tracking.surfaces.triangles import TriangleMesh, border_edges, faces_around, unit

DIRECTIONS = 64  # rays from each vertex
EXPOSED = 0.15  # fraction of unoccluded rays of an outer vertex
LIFT_MM = 0.05  # of the start of rays above the surface


class Posed(NamedTuple):
    """One pose of a rig.

    Attributes:
        coefficients: `(coefficient,)`.
        mesh: the surface.
    """

    coefficients: Tensor
    mesh: TriangleMesh


class RigSurface:
    """The surface of a rig that ends in a linear map.

    Args:
        rig: the rig.
        samples: number of evenly spread outer vertices that sample the skin.
        stability: weight of each vertex in rigid registration, `(vertex,)`; None: equal.

    Attributes:
        outer: whether each vertex is visible from outside, `(vertex,)`.
        sampled: indices of the vertices that sample the skin, `(sample,)`.
        centre: of the rest mesh, `(3,)`, mm: the pivot of rigid motion.
    """

    def __init__(self, rig: LinearRig, samples: int = 1500, stability: np.ndarray | None = None) -> None:
        self.rig = rig
        self.stability = np.ones(len(rig.rest_vertices)) if stability is None else stability
        self.faces = np.ascontiguousarray(rig.faces.cpu().numpy(), np.int64)
        self.border = border_edges(self.faces)
        self._around = faces_around(self.faces, len(rig.rest_vertices))
        rest = rig.rest_vertices.cpu().numpy().astype(np.float64)
        self.outer = exposure(rest, self.faces) > EXPOSED
        if not self.outer.any():
            self.outer[:] = True
        self.centre = rest[self.outer].mean(axis=0)
        outer = np.flatnonzero(self.outer)
        self.sampled = outer[farthest_points(rest[outer], samples)]
        self._rest = rig.rest_vertices.float()
        self._basis = rig.basis.float().flatten(1)  # (coefficient, 3 vertices)
        self._rows = self._basis.T.contiguous()  # (3 vertices, coefficient)
        self._neutral = rig.neutral_coefficients()[0].detach().float()

    def with_rest(self, rest: np.ndarray) -> "RigSurface":
        """The same rig with another mesh at rest `(vertex, 3)`, mm."""
        other = copy.copy(self)
        other._rest = torch.from_numpy(rest).float()
        return other

    @torch.no_grad()
    def pose(self, controls: Tensor) -> Posed:
        """The rig's surface at controls `(control,)`."""
        coefficients = self.rig.coefficients(controls[None].to(self.rig.dtype))[0].float()
        return self.posed(coefficients)

    @torch.no_grad()
    def posed(self, coefficients: Tensor, near: TriangleMesh | None = None) -> Posed:
        """The rig's surface at coefficients `(coefficient,)`; `near`: as it was before, perhaps with a search tree."""
        return Posed(coefficients, TriangleMesh(self.vertices(coefficients), self.faces, self.border, self._around, near))

    @torch.no_grad()
    def vertices(self, coefficients: Tensor) -> np.ndarray:
        """The rig's vertices `(vertex, 3)` at coefficients `(coefficient,)`, mm."""
        change = coefficients - self._neutral
        used = change.nonzero()[:, 0]
        moved = weighted_rows(self._basis, used, change[used], torch.tensor([0, len(used)]))
        return (self._rest + moved.view(-1, 3)).numpy()

    @torch.no_grad()
    def linearise(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        """Coefficients `(coefficient,)` at controls `(control,)`, and their Jacobian."""
        coefficients, jacobian = self.rig.coefficient_jacobian(controls[None].to(self.rig.dtype))
        return coefficients[0].float(), jacobian

    def rows(self, corners: np.ndarray, barycentric: np.ndarray, normals: np.ndarray) -> Tensor:
        """Derivatives of surface points along normals by the coefficients, `(point, coefficient)`, mm per unit.

        Args:
            corners, barycentric: of the points, `(point, corner)`.
            normals: `(point, 3)`.
        """
        return self.point_rows(corners, barycentric[:, :, None] * normals[:, None])

    def point_rows(self, corners: np.ndarray, by_corners: np.ndarray) -> Tensor:
        """Derivatives of values of the mesh by the coefficients, `(value, coefficient)`.

        Args:
            corners: indices of the vertices that each value depends on, `(value, corner)`.
            by_corners: its derivatives by these, `(value, corner, 3)`.
        """
        columns = (3 * corners[:, :, None] + np.arange(3)).reshape(len(corners), -1)
        values = by_corners.astype(np.float32).reshape(columns.shape)
        used = values != 0  # vertices have one corner of weight 1 and two of weight 0
        starts = torch.from_numpy(np.append(0, used.sum(axis=1).cumsum()))
        return weighted_rows(self._rows, torch.from_numpy(columns[used]), torch.from_numpy(values[used]), starts)


def weighted_rows(matrix: Tensor, rows: Tensor, weights: Tensor, starts: Tensor) -> Tensor:
    """Weighted sums of rows of a matrix `(row, column)`: four times as fast as sparse matrices of PyTorch.

    Args:
        rows, weights: indices of rows, and their weights, `(entry,)`, sum after sum.
        starts: the first entry of each sum, and the number of entries, `(sum + 1,)`.
    """
    sums = torch.nn.functional.embedding_bag
    return sums(rows, matrix, starts, mode="sum", per_sample_weights=weights, include_last_offset=True)


def exposure(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The fraction of unoccluded directions in each vertex's hemisphere, `(vertex,)`."""
    import trimesh  # half a second, and only scans need it

    mesh = trimesh.Trimesh(points, faces, process=False)
    normals = TriangleMesh(points, faces).normals
    directions = _sphere(DIRECTIONS)
    facing = normals @ directions.T > 0.05
    vertex, direction = np.nonzero(facing)
    start = points[vertex] + LIFT_MM * normals[vertex]
    hit = mesh.ray.intersects_any(start, directions[direction])
    free = np.bincount(vertex[~hit], minlength=len(points))
    return free / np.maximum(facing.sum(axis=1), 1)


def farthest_points(points: np.ndarray, count: int) -> np.ndarray:
    """Indices `(count,)` of points by greedy farthest point sampling."""
    if count >= len(points):
        return np.arange(len(points))
    points = points.astype(np.float32)
    chosen = np.zeros(count, np.int64)
    chosen[0] = np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1))
    distance = np.full(len(points), np.inf, np.float32)
    for number in range(1, count):
        distance = np.minimum(distance, ((points - points[chosen[number - 1]]) ** 2).sum(axis=1))
        chosen[number] = distance.argmax()
    return np.sort(chosen)


def _sphere(count: int) -> np.ndarray:
    """Evenly spread directions `(count, 3)` (Fibonacci sphere)."""
    number = np.arange(count) + 0.5
    z = 1 - 2 * number / count
    angle = np.pi * (1 + 5**0.5) * number
    ring = np.sqrt(1 - z**2)
    return unit(np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1))
