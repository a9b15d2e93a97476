"""A surrogate of many small MLPs, one for each shape, on the few inputs that it depends on."""

import functools
import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.config.values import PositiveInt, Widths
from riginv.networks.dependencies import find_dependencies
from riginv.networks.mlp import mlp
from riginv.networks.surrogate import SurrogateNetwork
from riginv.rig.interface import LinearRig

OPEN = 3.0  # negative bias of the damping of primary shapes: it starts near none
CONTEXT_GAIN = 0.1  # of the last layer of the context MLP


class LocalMlps(nn.Module):
    """One MLP of two hidden layers for each output, on its own selection of inputs.

    Args:
        outputs: number of outputs.
        slots: the greatest number of inputs of each.
        width: of the hidden layers.

    Attributes:
        index: the inputs of each output, `(output, slot)`, -1 for an empty slot.
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

    def forward(self, inputs: Float[Tensor, "batch input"]) -> Float[Tensor, "batch output"]:
        """Inputs `(batch, input)` to outputs `(batch, output)`."""
        selected = (inputs[:, self.index.clamp_min(0)] * (self.index >= 0)).transpose(0, 1)
        hidden = nn.functional.silu(torch.baddbmm(self.into_shift, selected, self.into))
        hidden = nn.functional.silu(torch.baddbmm(self.across_shift, hidden, self.across))
        return torch.baddbmm(self.out_shift, hidden, self.out)[:, :, 0].T

    def product(self, inputs: Float[Tensor, "batch input"]) -> Float[Tensor, "batch output"]:
        """The product `(batch, output)` of each output's inputs; 0 where it has none."""
        filled = self.index >= 0
        factors = torch.where(filled, inputs[:, self.index.clamp_min(0)], 1.0).unbind(dim=2)
        return functools.reduce(torch.mul, factors) * filled.any(dim=1)  # the gradient of torch.prod looks at values


class LocalSurrogate(SurrogateNetwork):
    """A surrogate of blendshapes with the rig's own dependencies (`riginv.networks.dependencies`).

    A primary shape is a small MLP of the controls that it depends on, damped by an MLP of all controls. A corrective is one of
    the shapes that it corrects, plus a multiple of the product of their weights, which most rigs use. Without blendshapes the
    surrogate is one MLP.

    Args:
        drivers: the greatest number of controls of a primary shape.
        parents: the greatest number of primary shapes of a corrective.
        width, corrective_width: of the small MLPs' hidden layers.
        context: hidden widths of the MLP that damps the primary shapes.
        hidden: hidden widths of the MLP for a rig without blendshapes.
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
        last = self.context[-1]
        assert isinstance(last, nn.Linear)
        with torch.no_grad():
            last.weight.mul_(CONTEXT_GAIN)
            last.bias.fill_(-OPEN)

    def set_scales(self, rig: LinearRig, controls: Float[Tensor, "batch control"]) -> None:
        super().set_scales(rig, controls)
        if self.weights:
            slots = self.primary.index.shape[1], self.corrective.index.shape[1]
            found = find_dependencies(rig, *slots)
            self.primary.index.copy_(found.drivers)
            self.corrective.index.copy_(found.parents)

    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        """The coefficients, without a sigmoid: so gradients do not vanish near 0 and 1."""
        if not self.weights:
            return super().forward(controls)
        return self.raw((controls - self.neutral) / self.half_range)

    def raw(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        if not self.weights:
            return self.dense(controls)
        undamped = self.primary(controls)
        damping = nn.functional.softplus(self.context(torch.cat([controls, undamped], dim=1)))
        primary = undamped * torch.exp(-damping)
        return torch.cat([primary, self.corrective(primary) + self.of_product * self.corrective.product(primary)], dim=1)
