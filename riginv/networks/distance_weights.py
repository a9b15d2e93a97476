"""Weights of vertices with which the gradient of squared distances is that of the mean distance.

The gradient of sum |d_v| is that of half the sum of w_v |d_v|^2 with w_v = 1 / |d_v| held fixed: iteratively reweighted least
squares (Weiszfeld's algorithm).
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.geometry.kernels.library import kernels_for
from riginv.geometry.products import linear, matmul
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import MeshSpace

CLUSTERS = 512  # of vertices: more of them tell more of the mean distance, and take longer
ROUNDS = 5  # of Lloyd's algorithm
LEAST = 0.1  # of the mean distance: what nearer vertices are taken for


class Weighted(NamedTuple):
    """What `DistanceWeights` makes of a batch of errors.

    Attributes:
        distance: the mean distance, where those of less than `LEAST` of it are rounded up, `(batch,)`.
        scale: the mean distance itself, `(batch, 1)`; divided by it and by the number of vertices, `error` is the derivative of
            `distance`.
        error: the weighted error.
    """

    distance: Tensor
    scale: Tensor
    error: Tensor


class DistanceWeights(nn.Module):
    """Weights the errors of mesh coordinates by vertices, one for each cluster of vertices that move alike.

    With d_k = Q_k z the displacement of a cluster's central vertex, n_k its number of vertices, n their sum and m the mean
    distance, the weighted error of z is sum_k n_k w_k Q_k^T d_k, w_k = m / |d_k|: the gradient of n m^2 / 2, which is half the
    squared length of z where all vertices move alike.

    Args:
        space: the mesh space.
        clusters: their number, at most.
    """

    frame: Tensor
    counts: Tensor

    def __init__(self, space: MeshSpace, clusters: int = CLUSTERS) -> None:
        super().__init__()
        clusters = min(clusters, space.vertex_count)
        self.register_buffer("frame", space.directions.new_zeros(space.size, 3 * clusters))
        self.register_buffer("counts", space.directions.new_ones(clusters))

    @torch.no_grad()
    def calibrate(self, space: MeshSpace) -> None:
        """Find the clusters, of vertices with similar directions of the mesh space."""
        moves = space.directions.transpose(0, 1).flatten(1)
        order = torch.randperm(len(moves), generator=generator_at(0, "clusters")).to(moves.device)
        centres = moves[order[: len(self.counts)]]
        for _ in range(ROUNDS):
            nearest = torch.cdist(moves, centres).argmin(dim=1)
            counts = torch.bincount(nearest, minlength=len(centres))
            sums = torch.zeros_like(centres).index_add_(0, nearest, moves)
            centres = torch.where(counts[:, None] > 0, sums / counts.clamp_min(1)[:, None], centres)
        distances = torch.cdist(moves, centres)
        self.counts.copy_(torch.bincount(distances.argmin(dim=1), minlength=len(centres)))
        self.frame.copy_(space.directions[:, distances.argmin(dim=0)].flatten(1))

    def forward(self, error: Float[Tensor, "batch coordinate"]) -> Weighted:
        """The distance of an error of mesh coordinates `(batch, coordinate)`, and the weighted error `(batch, coordinate)`."""
        displacements = matmul(error, self.frame)
        found = self._by_kernel(displacements, interleaved=True)
        if found is None:
            found = self.of_displacements(axis_by_axis(displacements))
            found = found._replace(error=found.error.mT.flatten(1))
        return found._replace(error=linear(found.error, self.frame))

    def of_displacements(self, displacements: Float[Tensor, "batch 3 cluster"]) -> Weighted:
        """The same of the displacements of all clusters, with n_k w_k d_k for the weighted error, `(batch, 3, cluster)`."""
        if (found := self._by_kernel(displacements, interleaved=False)) is not None:
            return found
        squares = displacements.square().sum(dim=1)
        count = self.counts.sum()
        mean = (squares.detach().sqrt() @ self.counts / count)[:, None]
        distances = (squares + (LEAST * mean).square() + torch.finfo(mean.dtype).tiny).sqrt()
        weights = self.counts * mean / distances.detach()
        return Weighted(distances @ self.counts / count, mean, weights[:, None] * displacements)

    def _by_kernel(self, displacements: Tensor, interleaved: bool) -> Weighted | None:
        """As `of_displacements`, or with the axes of each cluster together; None without a kernel, or with a graph."""
        is_plain = displacements.dtype == torch.float32 and not (displacements.requires_grad and torch.is_grad_enabled())
        compiled = kernels_for(displacements, self.counts) if is_plain else None
        if compiled is None:
            return None
        displacements, batch = displacements.contiguous(), len(displacements)
        error, distances = torch.empty_like(displacements), displacements.new_empty(2, batch, 1)
        given = displacements, int(interleaved), self.counts, len(self.counts), displacements.new_tensor(LEAST)
        compiled.call("weighted_distances", displacements.dtype, *given, error, distances, batch)
        return Weighted(distances[0, :, 0], distances[1], error)


def axis_by_axis(moves: Float[Tensor, "row move"]) -> Float[Tensor, "row 3 cluster"]:
    """Displacements one after the other, `(row, 3 * cluster)`, axis by axis: their squares are summed six times as fast."""
    return moves.unflatten(1, (-1, 3)).mT.contiguous()
