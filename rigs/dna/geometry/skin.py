"""Morph targets followed by linear blend skinning (LBS), for all vertices or for some."""

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from rigs.dna.geometry.sparse import SparseMap
from rigs.dna.logic.layout import Stage

POSES, VERTICES = 16, 2048  # block sizes for CPU caches; poses only without gradients


class Skin(Stage):
    """Vertices of a surface.

    Args:
        rest: `(vertex, 3)`, mm, about the skeleton's origin.
        weights: `(vertex, joint)`, in the order of the skinning matrices; the last column is of unskinned vertices.
        deltas: `(3 vertex, channel)`, mm.
    """

    def __init__(self, rest: np.ndarray, weights: sparse.csr_array, deltas: sparse.csr_array) -> None:
        super().__init__()
        self.rest, self.weights, self.deltas = rest, sparse.csr_array(weights), sparse.csr_array(deltas)
        groups = [np.arange(start, min(start + VERTICES, len(rest))) for start in range(0, len(rest), VERTICES)]
        self.sections = torch.nn.ModuleList(
            Section(rest[rows], self.weights[rows], self.deltas[coordinates_of(rows)]) for rows in groups
        )

    def forward(self, channels: Tensor, matrices: Tensor) -> Tensor:
        """Vertices `(batch, vertex, 3)`, mm, about the skeleton's origin.

        Args:
            channels: weights of the blendshape channels, `(batch, channel)`.
            matrices: skinning matrices `(joint, 3, 4, batch)`.
        """
        batch = len(channels)
        identity = torch.eye(4, 3, dtype=matrices.dtype, device=matrices.device)[None, ..., None]
        columns = torch.cat([matrices.transpose(1, 2), identity.expand(1, 4, 3, batch)])
        if torch.is_grad_enabled() or batch <= POSES:
            return self._posed(channels.T, columns)
        batches = zip(channels.T.split(POSES, dim=1), columns.split(POSES, dim=3))
        return torch.cat([self._posed(*batch) for batch in batches])

    def _posed(self, channels: Tensor, columns: Tensor) -> Tensor:
        return torch.cat([section(channels, columns) for section in self.sections]).permute(2, 0, 1)

    def some(self, rows: np.ndarray) -> "Skin":
        """The skin of a subset of the vertices."""
        return Skin(self.rest[rows], self.weights[rows], self.deltas[coordinates_of(rows)])


class Section(Stage):
    """A block of vertices; arguments as of `Skin`."""

    points: Tensor

    def __init__(self, rest: np.ndarray, weights: sparse.csr_array, deltas: sparse.csr_array) -> None:
        super().__init__()
        self.carried = SparseMap(weights)
        self.moved = SparseMap(deltas) if deltas.nnz else None
        self.keep(points=torch.tensor(rest))

    def forward(self, channels: Tensor, columns: Tensor) -> Tensor:
        """Weights of channels `(channel, batch)` and columns of matrices `(joint, 4, 3, batch)` to `(vertex, 3, batch)`."""
        points = self.points.to(columns)[..., None].expand(-1, -1, columns.shape[-1])
        if self.moved is not None:
            points = points + self.moved(channels).unflatten(0, (-1, 3))
        *linear, result = self.carried(columns.flatten(1)).unflatten(1, columns.shape[1:]).unbind(1)
        for column, point in zip(linear, points.unbind(1)):
            result = torch.addcmul(result, column, point[:, None])
        return result


def coordinates_of(vertices: np.ndarray) -> np.ndarray:
    """Indices `(3 vertex,)` of the coordinates of vertices."""
    return (3 * vertices[:, None] + np.arange(3)).reshape(-1)
