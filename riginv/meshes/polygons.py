"""Polygonal faces."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.errors import InputError


@dataclass(frozen=True)
class Polygons:
    """The faces of a mesh, of any number of corners.

    Attributes:
        sizes: the number of corners of each face, `(face,)`.
        corners: the vertex of each corner, face after face, `(corner,)`, from 0.
    """

    sizes: np.ndarray
    corners: np.ndarray

    def __len__(self) -> int:
        return len(self.sizes)

    def same_as(self, other: "Polygons") -> bool:
        return np.array_equal(self.sizes, other.sizes) and np.array_equal(self.corners, other.corners)

    def face(self, number: int) -> np.ndarray:
        """The vertices `(corner,)` of one face."""
        end = int(self.sizes[: number + 1].sum())
        return self.corners[end - int(self.sizes[number]) : end]

    def first_difference(self, other: "Polygons") -> int:
        """The index of the first face that differs, of two with equally many faces."""
        sizes = np.flatnonzero(self.sizes != other.sizes)
        same = int(self.sizes[: sizes[0]].sum()) if len(sizes) else len(self.corners)
        corners = np.flatnonzero(self.corners[:same] != other.corners[:same])
        return int(np.searchsorted(np.cumsum(self.sizes), corners[0], side="right")) if len(corners) else int(sizes[0])

    def edges(self) -> np.ndarray:
        """The unique edges `(edge, 2)`, each with its lower vertex first."""
        after = np.arange(1, len(self.corners) + 1)
        ends = np.cumsum(self.sizes)
        full = self.sizes > 0
        after[ends[full] - 1] = ends[full] - self.sizes[full]
        both = np.sort(np.stack([self.corners, self.corners[after]], axis=1), axis=1)
        return np.unique(both, axis=0)

    def fans(self) -> np.ndarray:
        """Triangles `(triangle, 3)`: each face as a fan around its first corner; none of faces of fewer than 3 corners."""
        triangles = np.maximum(self.sizes - 2, 0)
        starts = np.repeat(np.cumsum(self.sizes) - self.sizes, triangles)
        step = 1 + np.arange(len(starts)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
        return self.corners[np.stack([starts, starts + step, starts + step + 1], axis=1)]

    def among(self, vertices: np.ndarray) -> "Polygons":
        """The faces whose corners are all among some vertices `(vertex,)`, ascending, with indices into these."""
        if not len(vertices):
            return Polygons(np.zeros(0, np.int64), np.zeros(0, np.int64))
        index = np.minimum(np.searchsorted(vertices, self.corners), len(vertices) - 1)
        face = np.repeat(np.arange(len(self)), self.sizes)
        whole = np.bincount(face, vertices[index] != self.corners, len(self)) == 0
        return Polygons(self.sizes[whole], index[whole[face]])

    @classmethod
    def triangles(cls, faces: np.ndarray) -> "Polygons":
        """From `(face, 3)`."""
        return cls(np.full(len(faces), 3, np.int64), np.asarray(faces, np.int64).reshape(-1))

    @classmethod
    def strips(cls, sizes: np.ndarray, corners: np.ndarray) -> "Polygons":
        """From triangle strips: each corner forms a triangle with the two before it, -1 starts a new strip.

        Degenerate triangles, which connect strips, are left out.
        """
        corners = np.asarray(corners, np.int64)
        begins = np.zeros(len(corners) + 1, bool)
        begins[np.cumsum(sizes) - sizes] = True
        begins[1:] |= corners == -1
        start = np.maximum.accumulate(np.where(begins[:-1], np.arange(len(corners)), 0))
        last = np.flatnonzero((np.arange(len(corners)) - start >= 2) & (corners != -1))
        faces = np.stack([corners[last - 2], corners[last - 1], corners[last]], axis=1)
        odd = (last - start[last]) % 2 == 1
        faces[odd] = faces[odd][:, [1, 0, 2]]
        first, second, third = faces.T
        return cls.triangles(faces[(first != second) & (second != third) & (first != third)])

    def check(self, path: str | Path, vertices: int) -> None:
        """Raises InputError where a corner is not a vertex index."""
        if len(self.corners) and not 0 <= self.corners.min() <= self.corners.max() < vertices:
            wrong = self.corners[(self.corners < 0) | (self.corners >= vertices)][0]
            raise InputError(
                f"{path}: a face uses vertex {int(wrong)}, expected 0 to {vertices - 1}: the file is damaged; export it again"
            )
