"""Networks from controls to a rig's coefficients."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.networks.base import RigNetwork
from riginv.networks.mlp import mlp
from riginv.rig import LinearRig


class SurrogateNetwork(RigNetwork, ABC):
    """Maps controls `(batch, control)` to coefficients `(batch, coefficient)` of a rig: a learned f.

    The weights of blendshapes go through a sigmoid, as in the paper; other coefficients are free.
    """

    def __init__(self, rig: LinearRig) -> None:
        super().__init__()
        self.weights = rig.has_blendshapes

    @abstractmethod
    def raw(self, controls: Tensor) -> Tensor:
        """Coefficients before the sigmoid."""

    def forward(self, controls: Tensor) -> Tensor:
        raw = self.raw(controls)
        return torch.sigmoid(raw) if self.weights else raw


class ControlMLP(SurrogateNetwork):
    """The paper's: a perceptron on the controls as they are (paper: hidden 1024, 1024, leaky ReLU)."""

    def __init__(self, rig: LinearRig, hidden: Sequence[int] = (1024, 1024), activation: str = "leaky_relu") -> None:
        super().__init__(rig)
        self.network = mlp(len(rig.controls), hidden, len(rig.basis), activation)

    def raw(self, controls: Tensor) -> Tensor:
        return self.network(controls)


class CurveMLP(SurrogateNetwork):
    """A perceptron on a curve of each control: its position among hat functions over its range, so that it can bend freely.

    Args:
        hats: how many hat functions stand over the range of a control.

    Raises:
        InputError: fewer than two hats.
    """

    places: Tensor

    def __init__(
        self, rig: LinearRig, hats: int = 9, hidden: Sequence[int] = (1024, 1024), activation: str = "leaky_relu"
    ) -> None:
        super().__init__(rig)
        if hats < 2:
            raise InputError(f"network: hats is {hats}, expected at least 2")
        self.hats = hats
        self.register_buffer("lower", rig.lower, persistent=False)
        self.register_buffer("upper", rig.upper, persistent=False)
        self.register_buffer("places", torch.arange(hats, dtype=rig.dtype), persistent=False)
        self.network = mlp(len(rig.controls) * hats, hidden, len(rig.basis), activation)

    def raw(self, controls: Tensor) -> Tensor:
        position = (controls - self.lower) / (self.upper - self.lower) * (self.hats - 1)
        return self.network((1 - (position[..., None] - self.places).abs()).clamp_min(0).flatten(1))
