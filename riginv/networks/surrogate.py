"""Networks from controls to a rig's coefficients."""

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.config.values import Widths
from riginv.networks.base import RigNetwork
from riginv.networks.mlp import mlp
from riginv.rig.interface import LinearRig


class SurrogateNetwork(RigNetwork, ABC):
    """Maps controls `(batch, control)` to a rig's coefficients `(batch, coefficient)`.

    Of blendshape rigs the inputs are the controls and the outputs go through a sigmoid, as in the paper. Of other rigs, with
    degrees and millimetres, the inputs are fractions of the controls' ranges, and the outputs are offsets from the rest mesh's
    coefficients, scaled by their spread over poses.
    """

    middle: Tensor
    spread: Tensor
    neutral: Tensor
    half_range: Tensor

    def __init__(self, rig: LinearRig) -> None:
        super().__init__()
        self.weights = rig.has_blendshapes
        self.register_buffer("neutral", rig.neutral_controls, persistent=False)
        self.register_buffer("half_range", (rig.upper - rig.lower) / 2, persistent=False)
        if not self.weights:
            self.register_buffer("middle", torch.zeros(len(rig.basis), dtype=rig.dtype))
            self.register_buffer("spread", torch.ones(len(rig.basis), dtype=rig.dtype))

    @abstractmethod
    def raw(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        """Coefficients before the sigmoid, or scaled by their spread."""

    @torch.no_grad()
    def set_scales(self, rig: LinearRig, controls: Float[Tensor, "batch control"]) -> None:
        """Set fixed scales from sampled controls `(batch, control)`, before training."""
        if not self.weights:
            self.middle.copy_(rig.neutral_coefficients()[0])
            self.spread.copy_((rig.coefficients(controls) - self.middle).square().mean(dim=0).sqrt())

    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        if self.weights:
            return torch.sigmoid(self.raw(controls))
        return self.middle + self.spread * self.raw((controls - self.neutral) / self.half_range)


class ControlMLP(SurrogateNetwork):
    """The paper's: an MLP on the controls (hidden 1024, 1024, leaky ReLU)."""

    def __init__(self, rig: LinearRig, hidden: Widths = (1024, 1024), activation: str = "leaky_relu") -> None:
        super().__init__(rig)
        self.network = mlp(len(rig.controls), hidden, len(rig.basis), activation)

    def raw(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        return self.network(controls)
