"""The vertices that rigid motion is told by: some, spread over the mesh, each counting by how still the rig keeps it."""

import torch
from torch import Tensor

from riginv.geometry.blendshapes import apply_deltas
from riginv.rig.interface import LinearRig

ENOUGH = 1000  # of larger meshes so many vertices, spread evenly, tell as much as all
FEWEST = 100  # of them that must be known in every frame, for the others not to be needed


class Anchors:
    """Some vertices of a rig, and the rig's mesh at these alone.

    Args:
        rig: the rig.
        stability: how much each of its vertices counts, `(vertex,)`.
        stride: between two vertices that are taken.
    """

    def __init__(self, rig: LinearRig, stability: Tensor, stride: int | None = None) -> None:
        self.rig, self.stability = rig, stability
        self.stride = stride or max(1, len(stability) // ENOUGH)
        self.some = slice(None, None, self.stride)
        self.weights = stability[self.some]
        self.rest, self.basis = rig.rest_vertices[self.some], rig.basis[:, self.some].contiguous()

    @torch.no_grad()
    def mesh(self, controls: Tensor) -> Tensor:
        """Controls `(frame, control)` to the vertices `(frame, anchor, 3)`, mm."""
        change = self.rig.coefficients(controls) - self.rig.neutral_coefficients()
        return apply_deltas(self.rest, self.basis, change)

    def for_window(self, known: Tensor) -> "Anchors":
        """Anchors that are enough where only some vertices are known, `(frame, vertex)`."""
        enough = (
            self.stride == 1 or not len(known) or int((known[:, self.some] & (self.weights > 0)).sum(dim=1).min()) >= FEWEST
        )
        return self if enough else Anchors(self.rig, self.stability, stride=1)
