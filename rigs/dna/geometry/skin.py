"""The last step: morph targets, then linear blend skinning, for all vertices or for some."""

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from rigs.dna.geometry.sparse import SparseMap
from rigs.dna.logic.stage import Stage

PIECE = 16  # poses at a time where no gradient is wanted: what a processor's cache holds


class Skin(Stage):
    """Vertices of a surface.

    Args:
        rest: `(vertex, 3)`, mm, about the skeleton's origin.
        weights: `(vertex, joint)`, in the order of the skinning matrices; the last column is of vertices that no joint carries.
        deltas: `(3 vertex, channel)`, mm.
    """

    def __init__(self, rest: np.ndarray, weights: sparse.csr_array, deltas: sparse.csr_array) -> None:
        super().__init__()
        self.weights, self.deltas = SparseMap(weights), SparseMap(deltas)
        self.keep(rest=torch.tensor(rest))

    def forward(self, channels: Tensor, matrices: Tensor) -> Tensor:
        """Vertices `(batch, vertex, 3)`, mm, about the skeleton's origin.

        Args:
            channels: weights of the blendshape channels, `(batch, channel)`.
            matrices: skinning matrices `(joint, 3, 4, batch)`.
        """
        if torch.is_grad_enabled() or len(channels) <= PIECE:
            return self._posed(channels, matrices)
        pieces = zip(channels.split(PIECE), matrices.split(PIECE, dim=3))
        return torch.cat([self._posed(*piece) for piece in pieces])

    def _posed(self, channels: Tensor, matrices: Tensor) -> Tensor:
        joints, batch = len(matrices), len(channels)
        points = self.rest.to(channels)[..., None]
        if self.deltas.matrix.nnz:
            points = points + self.deltas(channels.T).unflatten(0, (-1, 3))  # (vertex, 3, batch)
        identity = torch.eye(4, 3, dtype=matrices.dtype, device=matrices.device)[None, ..., None]
        together = torch.cat([matrices.transpose(1, 2), identity.expand(1, 4, 3, batch)])
        columns = together.reshape(joints + 1, -1)
        blended = self.weights(columns).unflatten(1, (4, 3, batch))  # (vertex, column, row, batch)
        moved = blended[:, 3]
        for axis in range(3):
            moved = torch.addcmul(moved, blended[:, axis], points[:, axis, None])
        return moved.permute(2, 0, 1)

    def some(self, rows: np.ndarray) -> "Skin":
        """The same for some of the vertices."""
        coordinates = (3 * rows[:, None] + np.arange(3)).reshape(-1)
        return Skin(self.rest.numpy(force=True)[rows], self.weights.matrix[rows], self.deltas.matrix[coordinates])
