"""Meshes to mesh coordinates, as fast as the processor can: most of what an inverse takes is spent there."""

import torch
from torch import Tensor, nn

from riginv.mesh_space import MeshSpace


class QuickEncoder(nn.Module):
    """As `MeshSpace.encode`, in bfloat16 where a CPU multiplies such numbers: three times as fast as float32.

    What is rounded are displacements, by 1 part in 256 each. Spread over thousands of vertices that cancels: mesh coordinates
    come out within 0.2 % of their size. A network does not notice; a solver, or a rig that moves its mesh by metres, would.

    Args:
        space: whose coordinates.
        rounded: whether rounding is allowed at all.
    """

    def __init__(self, space: MeshSpace, rounded: bool = True) -> None:
        super().__init__()
        self.space = [space]  # in a list: its tensors are not this module's
        quick = rounded and space.frame.device.type == "cpu" and _multiplies_bfloat16()
        # no buffer: a module that is cast to another type must not take it along
        self.frame = space.frame.flatten(1).bfloat16() if quick else None

    def forward(self, vertices: Tensor) -> Tensor:
        """Meshes `(batch, vertex, 3)`, mm, to mesh coordinates `(batch, coordinate)`."""
        space = self.space[0]
        if self.frame is None or vertices.device.type != "cpu":
            return space.encode(vertices)
        return ((vertices - space.rest_vertices).flatten(1).bfloat16() @ self.frame.T).to(vertices.dtype)


def _multiplies_bfloat16() -> bool:
    ask = getattr(torch.cpu, "_is_avx512_bf16_supported", None)  # not a public name: it may go
    return ask is not None and ask()
