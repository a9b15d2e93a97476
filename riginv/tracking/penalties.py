"""What a user would rather see: dear and cheap controls, pairs that go together, pairs of which one should rest."""

from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.objective import CORNER, Linearised, Objective
from riginv.solvers.weighed_prior import WeighedPrior


@dataclass(frozen=True)
class ControlPenalties:
    """Penalties among the controls of an objective.

    Attributes:
        penalty_scale: what prior and sparsity of each control are multiplied with, `(control,)`.
        symmetric: pairs that should leave neutral alike, `(pair, 2)`, by number.
        exclusive: pairs of which at most one should leave neutral, `(pair, 2)`.
        symmetric_mm2, exclusive_mm2: how much that is worth, as the mean squared vertex distance that it may cost: for a pair a
            whole range apart, and for a pair that both leave neutral by their whole ranges.
    """

    penalty_scale: Tensor
    symmetric: Tensor
    exclusive: Tensor
    symmetric_mm2: float
    exclusive_mm2: float


class PenalisedObjective(Objective):
    """The objective with penalties in it. For a symmetric pair 0.5 s (a - b)^2 is added, for an exclusive one e |a| |b|,
    with a and b as far from neutral as the controls are, in shares of their ranges.
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        prior: float,
        sparsity: float,
        penalties: ControlPenalties,
        learned: WeighedPrior | None = None,
    ) -> None:
        penalty_scale = penalties.penalty_scale.to(rig.linear_map)
        super().__init__(rig, prior * penalty_scale, sparsity * penalty_scale, learned=learned)
        self.symmetric, self.exclusive = penalties.symmetric.T, penalties.exclusive.T
        self.together = penalties.symmetric_mm2 * self.vertex_count
        self.apart = penalties.exclusive_mm2 * self.vertex_count

    @torch.no_grad()
    def linearise(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Linearised:
        found = super().linearise(units, coordinates, weights)
        for (first, second), curvature in ((self.symmetric, -self.together), (self.exclusive, self.apart)):
            derivative = self._side(units, first) * self._side(units, second) if curvature > 0 else 1.0
            for row, column in ((first, second), (second, first)):
                found.hessian[:, row, column] += curvature * derivative
        return found

    def _side(self, units: Tensor, columns: Tensor) -> Tensor:
        """The derivative of a control's rounded distance from neutral, between -1 and 1."""
        away = (units - self.neutral)[:, columns]
        return away / (away.square() + CORNER**2).sqrt()

    def _preference(self, units: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        cost, gradient, curvature = super()._preference(units)
        away = units - self.neutral
        size = (away.square() + CORNER**2).sqrt()
        cost = cost + self._symmetric(away, gradient, curvature)
        return cost + self._exclusive(away, size, gradient, curvature), gradient, curvature

    def _symmetric(self, away: Tensor, gradient: Tensor, curvature: Tensor) -> Tensor:
        first, second = self.symmetric
        apart = away[:, first] - away[:, second]
        for columns, sign in ((first, 1.0), (second, -1.0)):
            gradient.index_add_(1, columns, sign * self.together * apart)
            curvature.index_add_(1, columns, torch.full_like(apart, self.together))
        return 0.5 * self.together * apart.square().sum(dim=1)

    def _exclusive(self, away: Tensor, size: Tensor, gradient: Tensor, curvature: Tensor) -> Tensor:
        """Of the product's Hessian, which is not definite, the part that is, half of ((a + b)^2), stands for all."""
        first, second = self.exclusive
        for columns, others in ((first, second), (second, first)):
            gradient.index_add_(1, columns, self.apart * away[:, columns] / size[:, columns] * size[:, others])
            curvature.index_add_(1, columns, torch.full_like(away[:, columns], self.apart))
        return self.apart * (size[:, first] * size[:, second]).sum(dim=1)
