"""Variants of the paper's networks, each with one change, to test the paper's claims on it (`riginv.reproduce`)."""

from torch import Tensor, nn

from riginv.config.values import Widths
from riginv.errors import InputError
from riginv.networks.control_maps import ControlMap
from riginv.networks.inverse import DirectInverse
from riginv.networks.mlp import ZeroPreserving
from riginv.networks.surrogate import ControlMLP
from riginv.rig.mesh_space import RigInMeshSpace

NORMALISATIONS = {"batch": nn.BatchNorm1d, "layer": nn.LayerNorm}


class NormalisedInverse(DirectInverse):
    """The paper's inverse with normalisation layers, which the paper advises against: one before each activation.

    Args:
        normalisation: `batch` or `layer`.

    Raises:
        InputError: there is no such normalisation.
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        normalisation: str,
        hidden: Widths = (2048, 1024, 512, 256),
        activation: str = "leaky_relu",
        control_map: str = "neutral_start",
    ) -> None:
        super().__init__(rig, hidden, activation, control_map)
        if normalisation not in NORMALISATIONS:
            raise InputError(
                f"network: normalisation '{normalisation}' is not known; choose one of {', '.join(NORMALISATIONS)}"
            )
        layer = NORMALISATIONS[normalisation]
        if isinstance(self.network, ZeroPreserving):
            self.network.network = _normalised(self.network.network, layer)
        else:
            self.network = _normalised(self.network, layer)


class UnboundedInverse(DirectInverse):
    """The paper's inverse with a linear output in place of tanh: in training it may leave the limits; `forward` clamps."""

    def __init__(self, rig: RigInMeshSpace, hidden: Widths = (2048, 1024, 512, 256), activation: str = "leaky_relu") -> None:
        super().__init__(rig, hidden, activation, "neutral_start")
        self.control_map = _Linear(rig.source)

    def forward(self, coordinates: Tensor) -> Tensor:
        return super().forward(coordinates).clamp(self.control_map.lower, self.control_map.upper)


class UnboundedSurrogate(ControlMLP):
    """The paper's surrogate without sigmoids: its weights may leave [0, 1]."""

    def forward(self, controls: Tensor) -> Tensor:
        return self.raw(controls) if self.weights else super().forward(controls)


class _Linear(ControlMap):
    """A linear map: 0 to the neutral controls, a difference of 1 to each control's range."""

    def forward(self, raw: Tensor) -> Tensor:
        return self.neutral + (self.upper - self.lower) * raw

    def raw_of(self, controls: Tensor) -> Tensor:
        return (controls - self.neutral) / (self.upper - self.lower)


def _normalised(network: nn.Module, layer: type[nn.Module]) -> nn.Sequential:
    """An MLP with a normalisation layer after each of its linear layers but the last."""
    assert isinstance(network, nn.Sequential)
    layers: list[nn.Module] = []
    for module in network:
        layers.append(module)
        if isinstance(module, nn.Linear) and module is not network[-1]:
            layers.append(layer(module.out_features))
    return nn.Sequential(*layers)
