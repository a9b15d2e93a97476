"""Controls as one-sided weights in [0, 1], as in the published solvers."""

import torch
from torch import Tensor

from riginv.rig.interface import RigBackend


class Sides:
    """The two directions of every control from neutral; a control whose neutral value is a limit has one.

    Attributes:
        control: whose side it is, `(side,)`.
        reach: signed distance from neutral to the limit, in the control's unit, `(side,)`.
        groups: for each control its one or two sides.
    """

    def __init__(self, rig: RigBackend) -> None:
        self.neutral, self.dtype, self.limits = rig.neutral_controls.double(), rig.dtype, (rig.lower, rig.upper)
        up, down = rig.upper.double() - self.neutral, rig.lower.double() - self.neutral
        found = [
            (control, reach) for control, both in enumerate(zip(up.tolist(), down.tolist())) for reach in both if reach != 0
        ]
        self.control = torch.tensor([control for control, _ in found])
        self.reach = torch.tensor([reach for _, reach in found], dtype=torch.float64)
        self.groups = [(self.control == control).nonzero()[:, 0].tolist() for control in range(len(self.neutral))]

    def __len__(self) -> int:
        return len(self.control)

    def controls(self, weights: Tensor) -> Tensor:
        """Weights `(batch, side)` as controls `(batch, control)`, exactly within the limits, in the rig's dtype.

        Where both sides of a control have a weight, they cancel.
        """
        change = torch.zeros(len(weights), len(self.neutral), dtype=torch.float64)
        change.index_add_(1, self.control, weights.double() * self.reach)
        return (self.neutral + change).to(self.dtype).clamp(*self.limits)
