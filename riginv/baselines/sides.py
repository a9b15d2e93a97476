"""Controls as the published solvers know them: one-sided weights in [0, 1]."""

import torch
from torch import Tensor

from riginv.rig import RigBackend


class Sides:
    """The two ways out of neutral of every control; a control that is neutral at a limit has only one.

    Attributes:
        control: whose side it is, `(side,)`.
        reach: how far the control goes that way, in its own unit, `(side,)`; negative for the way down.
        groups: for each control its one or two sides.
        alone: whether a side is the only one of its control, `(side,)`.
    """

    def __init__(self, rig: RigBackend) -> None:
        self.lower, self.upper, self.neutral = rig.lower.double(), rig.upper.double(), rig.neutral_controls.double()
        self.span, self.dtype, self.limits = self.upper - self.lower, rig.dtype, (rig.lower, rig.upper)
        up, down = self.upper - self.neutral, self.lower - self.neutral
        found = [
            (control, reach) for control, both in enumerate(zip(up.tolist(), down.tolist())) for reach in both if reach != 0
        ]
        self.control = torch.tensor([control for control, _ in found])
        self.reach = torch.tensor([reach for _, reach in found], dtype=torch.float64)
        self.groups = [(self.control == control).nonzero()[:, 0].tolist() for control in range(len(self.neutral))]
        self.alone = torch.tensor([len(self.groups[control]) == 1 for control in self.control.tolist()])

    def __len__(self) -> int:
        return len(self.control)

    def weights(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` as weights `(batch, side)`."""
        away = (controls.double() - self.neutral)[:, self.control]
        return (away / self.reach).clamp(0, 1)

    def controls(self, weights: Tensor) -> Tensor:
        """Weights `(batch, side)` as controls `(batch, control)`, exactly within the limits, in the rig's dtype."""
        change = torch.zeros(len(weights), len(self.neutral), dtype=torch.float64)
        change.index_add_(1, self.control, weights.double() * self.reach)
        return (self.neutral + change).to(self.dtype).clamp(*self.limits)

    def units(self, controls: Tensor) -> Tensor:
        """Controls as shares of their ranges, 0 at the lower limit."""
        return (controls.double() - self.lower) / self.span

    def of_units(self, units: Tensor) -> tuple[Tensor, Tensor]:
        """Shares of ranges `(batch, control)` as weights `(batch, side)`, and the slope of each weight by its control's share.

        At neutral the way up counts, where there is one.
        """
        away = (self.lower + self.span * units - self.neutral)[:, self.control]
        weights = away / self.reach
        active = torch.where(self.reach > 0, away >= 0, away < 0) | self.alone
        slopes = torch.where(active, self.span[self.control] / self.reach, 0.0)
        return weights.clamp(0, 1), slopes
