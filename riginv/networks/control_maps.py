"""Maps from a network's raw outputs to controls within the rig's limits."""

import math
from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.geometry.kernels.library import kernels_for
from riginv.rig.interface import RigBackend, Vjp

FULL, TINY = 0.995, 1e-12  # `raw_of` stops at this fraction of the range: closer to a limit the gradient vanishes
DEPTH = 1.0  # of a one-sided control: where on tanh's axis its limit lies, negated


class ControlMap(nn.Module, ABC):
    """Maps raw outputs `(batch, control)`, unbounded, to controls `(batch, control)` within a rig's limits.

    Attributes:
        lower, upper, neutral: `(control,)`, the rig's.
    """

    lower: Tensor
    upper: Tensor
    neutral: Tensor

    def __init__(self, rig: RigBackend) -> None:
        super().__init__()
        self.register_buffer("lower", rig.lower, persistent=False)
        self.register_buffer("upper", rig.upper, persistent=False)
        self.register_buffer("neutral", rig.neutral_controls, persistent=False)

    def with_vjp(self, raw: Float[Tensor, "batch control"]) -> tuple[Float[Tensor, "batch control"], Vjp]:
        """The controls `(batch, control)` without a graph, and their vector-Jacobian product to raw outputs."""
        with torch.enable_grad():
            given = raw.detach().requires_grad_()
            controls = self.forward(given)
        return controls.detach(), lambda gradient: torch.autograd.grad(controls, given, gradient, retain_graph=True)[0]

    @abstractmethod
    def raw_of(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch control"]:
        """Raw outputs that map to controls `(batch, control)`, or close to these at the limits or beyond."""


class RangeTanh(ControlMap):
    """The paper's: tanh scaled to each control's range; 0 maps to the middle of it."""

    def forward(self, raw: Float[Tensor, "batch control"]) -> Float[Tensor, "batch control"]:
        middle, half = (self.upper + self.lower) / 2, (self.upper - self.lower) / 2
        return middle + half * torch.tanh(raw)

    @torch.no_grad()
    def with_vjp(self, raw: Float[Tensor, "batch control"]) -> tuple[Float[Tensor, "batch control"], Vjp]:
        middle, half = (self.upper + self.lower) / 2, (self.upper - self.lower) / 2
        squashed = torch.tanh(raw)
        return middle + half * squashed, lambda gradient: _through_tanh(gradient * half, squashed)

    def raw_of(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch control"]:
        middle, half = (self.upper + self.lower) / 2, (self.upper - self.lower) / 2
        return torch.atanh(((controls - middle) / half).clamp(-FULL, FULL))


class NeutralStart(ControlMap):
    """0 maps to the neutral controls, and every control keeps a gradient there.

    A control that is neutral inside its range follows tanh, scaled separately on either side. One that is neutral at a limit
    follows the tail of tanh from that limit on; below, it stays at the limit with a straight-through gradient. Controls that
    start in the middle of their range get stuck in a rig's saturations (docs/experiments.md).
    """

    one_way: Tensor
    direction: Tensor
    depth: Tensor
    edge: Tensor
    norm: Tensor
    least: Tensor
    above: Tensor
    below: Tensor
    table: Tensor

    def __init__(self, rig: RigBackend) -> None:
        super().__init__(rig)
        one_way = torch.where(self.neutral <= self.lower, 1.0, torch.where(self.neutral >= self.upper, -1.0, 0.0))
        self.register_buffer("one_way", one_way.to(self.lower), persistent=False)
        # Both cases in one: scale * max((tanh(direction * raw - depth) + edge) / norm, least), one scale for each sign of raw.
        two_sided, edge = one_way == 0, math.tanh(DEPTH)
        above, below = self.upper - self.neutral, self.neutral - self.lower
        one_sided_scale = one_way * (above + below)
        buffers = {
            "direction": torch.where(two_sided, 1.0, one_way),
            "depth": torch.where(two_sided, 0.0, DEPTH),
            "edge": torch.where(two_sided, 0.0, edge),
            "norm": torch.where(two_sided, 1.0, 1 + edge),
            "least": torch.where(two_sided, -torch.inf, 0.0),
            "above": torch.where(two_sided, above, one_sided_scale),
            "below": torch.where(two_sided, below, one_sided_scale),
        }
        for name, values in buffers.items():
            self.register_buffer(name, values.to(self.lower), persistent=False)
        rows = [*buffers.values(), self.neutral]
        self.register_buffer("table", torch.stack([row.to(self.lower) for row in rows]), persistent=False)  # for the kernel

    def forward(self, raw: Float[Tensor, "batch control"]) -> Float[Tensor, "batch control"]:
        squashed = (torch.tanh(self.direction * raw - self.depth) + self.edge) / self.norm
        limited = squashed + (torch.maximum(squashed, self.least) - squashed).detach()
        return self.neutral + torch.where(raw >= 0, self.above, self.below) * limited

    @torch.no_grad()
    def with_vjp(self, raw: Float[Tensor, "batch control"]) -> tuple[Float[Tensor, "batch control"], Vjp]:
        if raw.dtype == torch.float32 and kernels_for(raw, self.table) is not None:
            controls, derivatives = self.with_derivatives(raw)
            return controls, derivatives.mul
        tail = torch.tanh(self.direction * raw - self.depth)
        scale = torch.where(raw >= 0, self.above, self.below)
        controls = self.neutral + scale * torch.maximum((tail + self.edge) / self.norm, self.least)
        return controls, lambda gradient: _through_tanh(gradient * scale / self.norm, tail) * self.direction

    def with_derivatives(self, raw: Float[Tensor, "batch control"]) -> tuple[Tensor, Tensor]:
        """The controls, and the derivative of each by its raw output, both `(batch, control)`: by a kernel, in float32."""
        compiled, raw = kernels_for(raw), raw.contiguous()
        assert compiled is not None
        controls, derivatives = torch.empty_like(raw), torch.empty_like(raw)
        compiled.call("neutral_start", raw.dtype, raw, self.table, raw.shape[1], controls, derivatives, len(raw))
        return controls, derivatives

    def raw_of(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch control"]:
        above, below = self.upper - self.neutral, self.neutral - self.lower
        change = controls - self.neutral
        two_sided = torch.atanh((change / torch.where(change >= 0, above, below).clamp_min(TINY)).clamp(-FULL, FULL))
        edge = math.tanh(DEPTH)
        tail = (self.one_way * change / (above + below)).clamp(0, FULL)
        one_sided = self.one_way * (torch.atanh(tail * (1 + edge) - edge) + DEPTH)
        return torch.where(self.one_way == 0, two_sided, one_sided)


def _through_tanh(gradient: Tensor, outputs: Tensor) -> Tensor:
    """The vector-Jacobian product of tanh, by its outputs; rounded as by automatic differentiation."""
    return torch.ops.aten.tanh_backward(gradient, outputs)


CONTROL_MAPS: dict[str, type[ControlMap]] = {"neutral_start": NeutralStart, "range_tanh": RangeTanh}
