"""One step of a learned optimiser: from a residual to a change of the controls."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.networks.mlp import Linear

START_GAIN = 0.05  # of the last layer: steps start small
SMALLEST = 1e-5  # of a typical gradient: the lower bound of its size under the logarithm
LOG_SCALE = 0.2


class StageStart(NamedTuple):
    """What a stage starts from, without a graph: the raw outputs of an estimate and what follows from them."""

    raw: Tensor
    coordinates: Tensor
    gradient: Tensor
    squares: Tensor

    def or_lower_error(self, other: "StageStart") -> "StageStart":
        """For each mesh the one with the lower error."""
        better = other.squares < self.squares
        return StageStart(*(torch.where(better.view(-1, *[1] * (b.dim() - 1)), b, a) for a, b in zip(self, other)))


class Correction(nn.Module):
    """A linear map from the residual to a step of the raw outputs, with gates that depend on the mesh.

    Like a Gauss-Newton step it is linear in the residual and its gradient, by a matrix that depends on the controls: `width`
    linear features of both, each multiplied by a gate of the raw outputs and the gradient's direction, then mixed. A zero
    residual gives a zero step, and errors shrink with each step; an MLP that has the residual among its inputs converges to a
    floor instead (docs/experiments.md).

    Args:
        residual: size of the residual.
        controls: number of controls.
        width: number of linear features.
        gate: hidden width of the gate.
    """

    def __init__(self, residual: int, controls: int, width: int, gate: int) -> None:
        super().__init__()
        self.features = Linear(residual + controls, width, bias=False)
        self.gate = nn.Sequential(Linear(2 * controls + 1, gate), nn.GELU(), Linear(gate, width))
        self.mix = Linear(width, controls, bias=False)
        with torch.no_grad():
            self.mix.weight.mul_(START_GAIN)

    def forward(
        self,
        residual: Float[Tensor, "batch residual"],
        gradient: Float[Tensor, "batch control"],
        raw: Float[Tensor, "batch control"],
    ) -> Float[Tensor, "batch control"]:
        """The change of the raw outputs `(batch, control)`.

        Args:
            residual: scaled.
            gradient: of the squared error by the raw outputs, scaled.
            raw: the raw outputs so far, squashed.
        """
        size = gradient.square().mean(dim=1, keepdim=True).sqrt() + SMALLEST
        gates = 1 + self.gate(torch.cat([raw, gradient / size, LOG_SCALE * size.log()], dim=1))
        return self.mix(gates * self.features(torch.cat([residual, gradient], dim=1)))


class Descent(Correction):
    """A correction that follows the gradient alone, so that its step is 0 at the best controls of any mesh.

    What the rig cannot make of a mesh stays in the residual: a step that follows it ends beside the best controls.

    Args:
        controls, width, gate: as of `Correction`.
    """

    def __init__(self, controls: int, width: int, gate: int) -> None:
        super().__init__(0, controls, width, gate)
