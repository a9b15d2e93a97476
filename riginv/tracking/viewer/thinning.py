"""Decimation of meshes by vertex clustering: one vertex for each cell of a grid."""

from typing import NamedTuple

import numpy as np


class Thinned(NamedTuple):
    """A decimated mesh.

    Attributes:
        kept: indices of its vertices in the original mesh, `(kept,)`.
        faces: `(face, 3)`, indices of `kept`.
    """

    kept: np.ndarray
    faces: np.ndarray


def thin(vertices: np.ndarray, faces: np.ndarray, limit: int) -> Thinned:
    """Keep at most `limit` vertices `(vertex, 3)`: in each cell of a grid the one nearest to the mean of its vertices.

    Faces with corners in fewer than three cells are removed.
    """
    if len(vertices) <= limit:
        return Thinned(np.arange(len(vertices)), faces)
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    cells = np.sqrt(limit)  # a surface in a grid of n³ cells meets about n² of them
    while True:
        _, cell = np.unique(np.floor((vertices - low) / (size / cells)).astype(np.int64), axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        count = int(cell.max()) + 1
        if count <= limit:
            break
        cells *= max(0.5, 0.97 * np.sqrt(limit / count))
    middles = np.stack([np.bincount(cell, vertices[:, axis]) for axis in range(3)], axis=1) / np.bincount(cell)[:, None]
    order = np.argsort(np.linalg.norm(vertices - middles[cell], axis=1), kind="stable")
    kept = np.empty(count, np.int64)
    kept[cell[order[::-1]]] = order[::-1]  # the nearest one is written last
    mapped = cell[faces]
    is_face = (mapped[:, 0] != mapped[:, 1]) & (mapped[:, 1] != mapped[:, 2]) & (mapped[:, 2] != mapped[:, 0])
    return Thinned(kept, mapped[is_face])
