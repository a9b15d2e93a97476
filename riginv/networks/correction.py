"""One step of a learned optimiser: what is left of a mesh, taken to a change of the controls."""

import torch
from torch import Tensor, nn

START_GAIN = 0.05  # of the last layer: a correction starts small
FAINTEST = 1e-5  # of a typical gradient: below it the logarithm of its size stands still
LOG_SCALE = 0.2


class Correction(nn.Module):
    """A linear map from what is left to raw outputs, mixed anew for every mesh.

    A Gauss-Newton step is linear in the residual and its gradient, by a matrix that depends on where the controls stand. So
    is this: `width` linear features of both, each weighed by a gate that sees the raw outputs and the direction of the
    gradient, then mixed. Where nothing is left nothing changes, and what a step leaves shrinks with what it was given: a
    MLP that sees the residual as one input among others leaves a floor instead (docs/experiments.md).

    Args:
        left: numbers that say what is left.
        controls: of the rig.
        width: linear features.
        gate: hidden width of the gate.
    """

    def __init__(self, left: int, controls: int, width: int, gate: int) -> None:
        super().__init__()
        self.features = nn.Linear(left + controls, width, bias=False)
        self.gate = nn.Sequential(nn.Linear(2 * controls + 1, gate), nn.GELU(), nn.Linear(gate, width))
        self.mix = nn.Linear(width, controls, bias=False)
        with torch.no_grad():
            self.mix.weight.mul_(START_GAIN)

    def forward(self, left: Tensor, gradient: Tensor, raw: Tensor) -> Tensor:
        """The change of the raw outputs `(batch, control)`.

        Args:
            left: what is left of the mesh, scaled, `(batch, number)`.
            gradient: of the squared error with respect to the raw outputs, scaled, `(batch, control)`.
            raw: the raw outputs so far, squashed, `(batch, control)`.
        """
        size = gradient.square().mean(dim=1, keepdim=True).sqrt() + FAINTEST
        gates = 1 + self.gate(torch.cat([raw, gradient / size, LOG_SCALE * size.log()], dim=1))
        return self.mix(gates * self.features(torch.cat([left, gradient], dim=1)))
