"""Small networks from controls to controls."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from rigs.dna.format.later_layers import MachineLearning, Net
from rigs.dna.logic.layout import Layout, Stage, put

LEAKY, ACTIVATIONS = 2, 5


class NetStage(Stage):
    """One net.

    Raises:
        InputError: its layers do not fit each other, its inputs or its outputs.
    """

    def __init__(self, layout: Layout, what: str, net: Net, inputs: int, outputs: int | None) -> None:
        super().__init__()
        self.activations: list[int] = []
        self.slopes: list[float] = []
        width = inputs
        for number, layer in enumerate(net.layers):
            name, size = f"layer {number} of {what}", len(layer.biases)
            if len(layer.weights) != size * width:
                raise layout.wrong(f"{name} has {len(layer.weights)} weights, expected {size} x {width}")
            if layer.activation >= ACTIVATIONS or (layer.activation == LEAKY and not len(layer.parameters)):
                raise layout.wrong(f"{name} has activation {layer.activation} with {len(layer.parameters)} parameters")
            layout.check_finite(name, np.concatenate([layer.biases, layer.weights, layer.parameters]))
            weights = layer.weights.reshape(size, width).astype(np.float64)
            self.keep(**{f"weights{number}": weights, f"biases{number}": layer.biases.astype(np.float64)})
            self.activations.append(int(layer.activation))
            self.slopes.append(float(layer.parameters[0]) if len(layer.parameters) else 0.0)
            width = size
        if outputs is not None and width != outputs:
            raise layout.wrong(f"{what} gives {width} numbers for {outputs} controls")
        self.size = width

    def forward(self, values: Tensor) -> Tensor:
        """Inputs `(batch, input)` to outputs `(batch, output)`."""
        for number, (activation, slope) in enumerate(zip(self.activations, self.slopes)):
            weights, biases = self.get_buffer(f"weights{number}"), self.get_buffer(f"biases{number}")
            values = functional.linear(values, weights.to(values), biases.to(values))
            values = _activated(values, activation, slope)
        return values


class Nets(Stage):
    """The nets of a level of detail, evaluated in order.

    Raises:
        InputError: a net is damaged, or writes a PSD.
    """

    def __init__(self, layout: Layout, learned: MachineLearning, lod: int) -> None:
        super().__init__()
        chosen = layout.rows_of_lod("the nets", learned.lod_nets, lod, len(learned.nets), "nets").tolist()
        self.nets = torch.nn.ModuleList()
        for number in chosen:
            net, what = learned.nets[number], f"net {number}"
            check_outputs(layout, what, net.outputs)
            layout.check_controls(f"an input of {what}", net.inputs)
            stage = NetStage(layout, what, net, len(net.inputs), len(net.outputs))
            stage.keep(inputs=net.inputs.astype(int), outputs=net.outputs.astype(int))
            self.nets.append(stage)
        self.independent = _independent([learned.nets[number] for number in chosen])

    def forward(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)`, with the outputs of the nets."""
        inputs, outputs = ([net.get_buffer(name) for net in self.nets] for name in ("inputs", "outputs"))
        if self.independent and len(self.nets):
            found = torch.cat([net(controls.index_select(1, index)) for net, index in zip(self.nets, inputs)], dim=1)
            return put(controls, torch.cat(outputs), found)
        for net, index, output in zip(self.nets, inputs, outputs):
            controls = put(controls, output, net(controls.index_select(1, index)))
        return controls


def _activated(values: Tensor, activation: int, slope: float) -> Tensor:
    if activation == LEAKY:
        return functional.leaky_relu(values, slope)
    return {1: torch.relu, 3: torch.tanh, 4: torch.sigmoid}[activation](values) if activation else values


def check_outputs(layout: Layout, what: str, outputs: np.ndarray) -> None:
    """Raises InputError where outputs include missing controls, or PSDs, which would be overwritten."""
    layout.check_controls(f"an output of {what}", outputs)
    inside = (outputs >= layout.psds.start) & (outputs < layout.psds.stop)
    if inside.any():
        raise layout.wrong(
            f"{what} writes control {int(outputs[np.argmax(inside)])}, which is a PSD: controls {layout.psds.start} to "
            f"{layout.psds.stop - 1} are products of others"
        )


def _independent(nets: Sequence[Net]) -> bool:
    """Whether no net reads or overwrites outputs of another."""
    written: set[int] = set()
    for net in nets:
        outputs = net.outputs.tolist()
        if written & {*net.inputs.tolist(), *outputs} or len(set(outputs)) < len(outputs):
            return False
        written.update(outputs)
    return True
