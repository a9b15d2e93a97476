"""The vertices that rigid motion is estimated from: a subset of the mesh, weighted by how little the rig moves them."""

import torch
from torch import Tensor

from riginv.geometry.blendshapes import apply_deltas
from riginv.geometry.kernels.library import kernels_for
from riginv.rig.interface import LinearRig
from riginv.rig.sparse_basis import SparseBasis

COUNT = 1000  # about as many vertices, evenly spread, are used of larger meshes
MIN_KNOWN = 100  # of them that must be known in every frame; else all vertices are used


class Anchors:
    """A subset of a rig's vertices, and the rig's mesh at these alone.

    Args:
        rig: the rig.
        stability: weight of each of its vertices, `(vertex,)`, see `stability_weights`.
        stride: between two vertices of the subset.
    """

    def __init__(self, rig: LinearRig, stability: Tensor, stride: int | None = None) -> None:
        self.rig, self.stability = rig, stability
        self.stride = stride or max(1, len(stability) // COUNT)
        self.vertices = slice(None, None, self.stride)
        self.weights = stability[self.vertices]
        self.rest, self.basis = rig.rest_vertices[self.vertices], rig.basis[:, self.vertices].contiguous()
        self.sparse = SparseBasis.of(self.basis)

    @torch.no_grad()
    def mesh(self, controls: Tensor) -> Tensor:
        """Controls `(frame, control)` to the vertices `(frame, anchor, 3)`, mm."""
        change = self.rig.coefficients(controls) - self.rig.neutral_coefficients()
        if self.sparse is not None and kernels_for(change, self.rest) is not None:
            return self.sparse.vertices(self.rest, change)
        return apply_deltas(self.rest, self.basis, change)

    def for_window(self, known: Tensor) -> "Anchors":
        """These anchors, or all vertices where too few of the anchors are known, `(frame, vertex)`."""
        if self.stride == 1 or not len(known):
            return self
        count = (known[:, self.vertices] & (self.weights > 0)).sum(dim=1)
        return self if int(count.min()) >= MIN_KNOWN else Anchors(self.rig, self.stability, stride=1)
