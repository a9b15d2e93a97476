"""A surrogate that knows who follows whom: many small MLPs, each seeing a few numbers only."""

import math

import torch
from torch import Tensor, nn

from riginv.config.values import PositiveInt, Widths
from riginv.networks.dependencies import find_dependencies
from riginv.networks.mlp import mlp
from riginv.networks.surrogate import SurrogateNetwork
from riginv.rig.interface import LinearRig

OPEN = 3.0  # how far the damping of a primary shape starts from acting
CONTEXT_GAIN = 0.1  # of the last layer of the context: it starts with hardly a say


class LocalMlps(nn.Module):
    """One MLP of two hidden layers for each output, on inputs of its own.

    Args:
        outputs: how many.
        slots: inputs of each, at most.
        width: of the hidden layers.
    """

    index: Tensor

    def __init__(self, outputs: int, slots: int, width: int) -> None:
        super().__init__()
        self.register_buffer("index", torch.full((outputs, slots), -1))
        self.into = nn.Parameter(torch.randn(outputs, slots, width))
        self.into_shift = nn.Parameter(torch.randn(outputs, 1, width) / math.sqrt(2))
        self.across = nn.Parameter(torch.randn(outputs, width, width) / math.sqrt(width))
        self.across_shift = nn.Parameter(torch.zeros(outputs, 1, width))
        self.out = nn.Parameter(torch.randn(outputs, width, 1) / math.sqrt(width))
        self.out_shift = nn.Parameter(torch.zeros(outputs, 1, 1))

    def forward(self, inputs: Tensor) -> Tensor:
        """Inputs `(batch, input)` to outputs `(batch, output)`."""
        seen = (inputs[:, self.index.clamp_min(0)] * (self.index >= 0)).transpose(0, 1)
        hidden = nn.functional.silu(torch.baddbmm(self.into_shift, seen, self.into))
        hidden = nn.functional.silu(torch.baddbmm(self.across_shift, hidden, self.across))
        return torch.baddbmm(self.out_shift, hidden, self.out)[:, :, 0].T

    def product(self, inputs: Tensor) -> Tensor:
        """The product `(batch, output)` of each output's own inputs; 0 where it has none."""
        filled = self.index >= 0
        return torch.where(filled, inputs[:, self.index.clamp_min(0)], 1.0).prod(dim=2) * filled.any(dim=1)


class LocalSurrogate(SurrogateNetwork):
    """A surrogate of blendshapes that takes from the rig, by posing it, what follows what (`riginv.networks.dependencies`).

    A primary shape is a small MLP on its own controls, damped by what all of them do together; a shape that corrects
    others is one on those, beside a multiple of the product of their weights: most rigs mean one, and where all of them are
    strong poses are rare and a MLP knows least. Rigs without blendshapes have no such parts: theirs is one MLP.

    Args:
        drivers: controls that a primary shape follows, at most.
        parents: primary shapes that a corrective one follows, at most.
        width, corrective_width: of the small MLPs' hidden layers.
        context: widths of the MLP that damps the primary shapes.
        hidden: widths of the one MLP for a rig without blendshapes.
    """

    def __init__(
        self,
        rig: LinearRig,
        drivers: PositiveInt = 4,
        parents: PositiveInt = 3,
        width: PositiveInt = 32,
        corrective_width: PositiveInt = 16,
        context: Widths = (256,),
        hidden: Widths = (1024, 1024),
    ) -> None:
        super().__init__(rig)
        controls, primaries = len(rig.controls), rig.primary_count
        if not self.weights:
            self.dense = mlp(controls, hidden, len(rig.basis), "leaky_relu")
            return
        self.primary = LocalMlps(primaries, drivers, width)
        self.corrective = LocalMlps(len(rig.basis) - primaries, parents, corrective_width)
        self.of_product = nn.Parameter(torch.ones(len(rig.basis) - primaries))
        self.context = mlp(controls + primaries, context, primaries, "silu")
        with torch.no_grad():
            self.context[-1].weight.mul_(CONTEXT_GAIN)
            self.context[-1].bias.fill_(-OPEN)

    def set_scales(self, rig: LinearRig, controls: Tensor) -> None:
        super().set_scales(rig, controls)
        if self.weights:
            slots = self.primary.index.shape[1], self.corrective.index.shape[1]
            found = find_dependencies(rig, *slots)
            self.primary.index.copy_(found.drivers)
            self.corrective.index.copy_(found.parents)

    def forward(self, controls: Tensor) -> Tensor:
        """Weights are kept in no range: where they exceed it the loss says so, and no gradient fades at its ends."""
        if not self.weights:
            return super().forward(controls)
        return self.raw((controls - self.neutral) / self.half_range)

    def raw(self, controls: Tensor) -> Tensor:
        if not self.weights:
            return self.dense(controls)
        alone = self.primary(controls)
        damping = nn.functional.softplus(self.context(torch.cat([controls, alone], dim=1)))
        primary = alone * torch.exp(-damping)
        return torch.cat([primary, self.corrective(primary) + self.of_product * self.corrective.product(primary)], dim=1)
