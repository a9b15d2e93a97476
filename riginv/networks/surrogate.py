"""Networks from controls to a rig's coefficients."""

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from riginv.config.values import Widths
from riginv.networks.base import RigNetwork
from riginv.networks.mlp import mlp
from riginv.rig.interface import LinearRig


class SurrogateNetwork(RigNetwork, ABC):
    """Maps controls `(batch, control)` to coefficients `(batch, coefficient)` of a rig: a learned f.

    The weights of blendshapes go through a sigmoid, as in the paper, and their controls in as they are. Other rigs mix
    degrees with millimetres: their controls go in as shares of their ranges, and their coefficients come out around those of
    the rest mesh, each in the measure of its spread over poses of the rig.
    """

    middle: Tensor
    spread: Tensor

    def __init__(self, rig: LinearRig) -> None:
        super().__init__()
        self.weights = rig.has_blendshapes
        self.register_buffer("neutral", rig.neutral_controls, persistent=False)
        self.register_buffer("half_range", (rig.upper - rig.lower) / 2, persistent=False)
        if not self.weights:
            self.register_buffer("middle", torch.zeros(len(rig.basis), dtype=rig.dtype))
            self.register_buffer("spread", torch.ones(len(rig.basis), dtype=rig.dtype))

    @abstractmethod
    def raw(self, controls: Tensor) -> Tensor:
        """Coefficients before the sigmoid, or in the measure of their spread."""

    @torch.no_grad()
    def set_scales(self, rig: LinearRig, controls: Tensor) -> None:
        """Look at a sample of the controls that will come `(batch, control)`, before training, to set fixed scales."""
        if not self.weights:
            self.middle.copy_(rig.neutral_coefficients()[0])
            self.spread.copy_((rig.coefficients(controls) - self.middle).square().mean(dim=0).sqrt())

    def forward(self, controls: Tensor) -> Tensor:
        if self.weights:
            return torch.sigmoid(self.raw(controls))
        return self.middle + self.spread * self.raw((controls - self.neutral) / self.half_range)


class ControlMLP(SurrogateNetwork):
    """The paper's: a MLP on the controls as they are (paper: hidden 1024, 1024, leaky ReLU)."""

    def __init__(self, rig: LinearRig, hidden: Widths = (1024, 1024), activation: str = "leaky_relu") -> None:
        super().__init__(rig)
        self.network = mlp(len(rig.controls), hidden, len(rig.basis), activation)

    def raw(self, controls: Tensor) -> Tensor:
        return self.network(controls)
