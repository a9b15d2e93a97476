"""Networks from controls to a rig's coefficients."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor

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
