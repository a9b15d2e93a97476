"""Fewer vertices to look at: those of a fine grid's cells become one."""

from typing import NamedTuple

import numpy as np


class Thinned(NamedTuple):
    """Some vertices of a mesh.

    Attributes:
        kept: their numbers in the whole mesh, `(kept,)`.
        faces: `(face, 3)`, indices of `kept`.
    """

    kept: np.ndarray
    faces: np.ndarray


def thin(vertices: np.ndarray, faces: np.ndarray, most: int) -> Thinned:
    """Keep at most `most` vertices `(vertex, 3)`: of each cell of a grid the one nearest to its vertices' middle.

    Faces whose corners fall into fewer than three cells vanish.
    """
    if len(vertices) <= most:
        return Thinned(np.arange(len(vertices)), faces)
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    cells = np.sqrt(most)  # a surface in a grid of n³ cells meets about n² of them
    while True:
        _, cell = np.unique(np.floor((vertices - low) / (size / cells)).astype(np.int64), axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        count = int(cell.max()) + 1
        if count <= most:
            break
        cells *= max(0.5, 0.97 * np.sqrt(most / count))
    middles = np.stack([np.bincount(cell, vertices[:, axis]) for axis in range(3)], axis=1) / np.bincount(cell)[:, None]
    order = np.argsort(np.linalg.norm(vertices - middles[cell], axis=1), kind="stable")
    kept = np.empty(count, np.int64)
    kept[cell[order[::-1]]] = order[::-1]  # the nearest one is written last
    mapped = cell[faces]
    whole = (mapped[:, 0] != mapped[:, 1]) & (mapped[:, 1] != mapped[:, 2]) & (mapped[:, 2] != mapped[:, 0])
    return Thinned(kept, mapped[whole])
