"""From a network's raw outputs to controls within the rig's limits."""

import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from riginv.rig import RigBackend

FULL, TINY = 0.995, 1e-12  # a control closer to its limit than this share would have hardly any gradient
DEPTH = 1.0  # how far into tanh's tail a control at its limit starts


class ControlMap(nn.Module, ABC):
    """Maps raw outputs `(batch, control)`, unbounded, to controls `(batch, control)` within a rig's limits.

    Attributes:
        lower, upper, neutral: `(control,)`, the rig's.
    """

    def __init__(self, rig: RigBackend) -> None:
        super().__init__()
        self.register_buffer("lower", rig.lower, persistent=False)
        self.register_buffer("upper", rig.upper, persistent=False)
        self.register_buffer("neutral", rig.neutral_controls, persistent=False)

    @abstractmethod
    def raw_of(self, controls: Tensor) -> Tensor:
        """Raw outputs that map to controls `(batch, control)`, or near them where these lie at their limits or beyond."""


class RangeTanh(ControlMap):
    """The paper's: tanh scaled to each control's range, so that every control starts in the middle of it."""

    def forward(self, raw: Tensor) -> Tensor:
        middle, half = (self.upper + self.lower) / 2, (self.upper - self.lower) / 2
        return middle + half * torch.tanh(raw)

    def raw_of(self, controls: Tensor) -> Tensor:
        middle, half = (self.upper + self.lower) / 2, (self.upper - self.lower) / 2
        return torch.atanh(((controls - middle) / half).clamp(-FULL, FULL))


class NeutralStart(ControlMap):
    """0 maps to the neutral controls, and every control keeps a gradient there.

    A control that is neutral inside its range follows tanh, scaled to either side. One that is neutral at a limit follows the
    tail of tanh from that limit; below it the control stays at the limit while the gradient passes as if it did not.
    Controls that start in the middle of their range die in a rig's saturations (docs/experiments.md); these do not.
    """

    def __init__(self, rig: RigBackend) -> None:
        super().__init__(rig)
        one_way = torch.where(self.neutral <= self.lower, 1.0, torch.where(self.neutral >= self.upper, -1.0, 0.0))
        self.register_buffer("one_way", one_way.to(self.lower), persistent=False)

    def forward(self, raw: Tensor) -> Tensor:
        above, below = self.upper - self.neutral, self.neutral - self.lower
        two_sided = torch.where(raw >= 0, above, below) * torch.tanh(raw)
        edge = math.tanh(DEPTH)
        tail = (torch.tanh(self.one_way * raw - DEPTH) + edge) / (1 + edge)
        limited = tail + (tail.clamp_min(0) - tail).detach()
        one_sided = self.one_way * (above + below) * limited
        return self.neutral + torch.where(self.one_way == 0, two_sided, one_sided)

    def raw_of(self, controls: Tensor) -> Tensor:
        above, below = self.upper - self.neutral, self.neutral - self.lower
        change = controls - self.neutral
        two_sided = torch.atanh((change / torch.where(change >= 0, above, below).clamp_min(TINY)).clamp(-FULL, FULL))
        edge = math.tanh(DEPTH)
        tail = (self.one_way * change / (above + below)).clamp(0, FULL)
        one_sided = self.one_way * (torch.atanh(tail * (1 + edge) - edge) + DEPTH)
        return torch.where(self.one_way == 0, two_sided, one_sided)


CONTROL_MAPS = {"neutral_start": NeutralStart, "range_tanh": RangeTanh}
