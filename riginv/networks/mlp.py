"""MLPs: linear layers with activations between them."""

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.products import linear

ACTIVATIONS = {"leaky_relu": nn.LeakyReLU, "relu": nn.ReLU, "gelu": nn.GELU, "silu": nn.SiLU, "tanh": nn.Tanh}


class Linear(nn.Linear):
    """As `nn.Linear`, by the faster of PyTorch's libraries."""

    def forward(self, inputs: Tensor) -> Tensor:
        return linear(inputs, self.weight, self.bias)


def mlp(inputs: int, hidden: Sequence[int], outputs: int, activation: str = "leaky_relu") -> nn.Sequential:
    """An MLP with a linear output and no normalisation layers (the paper found that they hurt).

    Raises:
        InputError: a width is below 1 or the activation is not known.
    """
    if activation not in ACTIVATIONS:
        raise InputError(f"network: activation '{activation}' is not known; choose one of {', '.join(ACTIVATIONS)}")
    if not all(isinstance(width, int) and width >= 1 for width in hidden):
        raise InputError(f"network: hidden is {list(hidden)}, expected widths of at least 1")
    widths = [inputs, *hidden]
    layers: list[nn.Module] = []
    for before, after in itertools.pairwise(widths):
        layers += [Linear(before, after), ACTIVATIONS[activation]()]
    return nn.Sequential(*layers, Linear(widths[-1], outputs))


def small_outputs(network: nn.Sequential, gain: float) -> nn.Sequential:
    """The network itself, its last layer's weights times `gain` and without a bias, so that training starts near 0."""
    last = network[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.weight.mul_(gain)
        last.bias.zero_()
    return network


class ZeroPreserving(nn.Module):
    """A network minus its output at 0, so that it maps 0 to 0 exactly: the neutral mesh to the neutral controls."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, inputs: Tensor) -> Tensor:
        outputs = self.network(torch.cat([inputs, torch.zeros_like(inputs[:1])]))
        return outputs[:-1] - outputs[-1:]
