"""Penalties on controls: a scale for each, symmetric pairs, exclusive pairs."""

from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.objective import CORNER, GaussianPrior, Linearised, Objective


@dataclass(frozen=True)
class ControlPenalties:
    """Penalties among the controls of an objective.

    Attributes:
        penalty_scale: factor on prior and sparsity of each control, `(control,)`.
        symmetric: indices of pairs that should leave neutral equally, `(pair, 2)`.
        exclusive: indices of pairs of which at most one should leave neutral, `(pair, 2)`.
        symmetric_mm2, exclusive_mm2: penalties as mean squared vertex distances: for a pair that differs by a whole range, and
            for a pair that both leave neutral by their whole ranges.
    """

    penalty_scale: Tensor
    symmetric: Tensor
    exclusive: Tensor
    symmetric_mm2: float
    exclusive_mm2: float


class PenalisedObjective(Objective):
    """The objective plus penalties: 0.5 s (a - b)^2 for a symmetric pair, e |a| |b| for an exclusive one, where a and b are
    the distances of the controls from neutral, as fractions of their ranges.
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        prior: float,
        sparsity: float,
        penalties: ControlPenalties,
        learned: GaussianPrior | None = None,
    ) -> None:
        penalty_scale = penalties.penalty_scale.to(rig.linear_map)
        super().__init__(rig, prior * penalty_scale, sparsity * penalty_scale, learned=learned)
        self.symmetric, self.exclusive = penalties.symmetric.T, penalties.exclusive.T
        self.symmetric_penalty = penalties.symmetric_mm2 * self.vertex_count
        self.exclusive_penalty = penalties.exclusive_mm2 * self.vertex_count

    @torch.no_grad()
    def linearise(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Linearised:
        found = super().linearise(units, coordinates, weights)
        for (first, second), curvature in ((self.symmetric, -self.symmetric_penalty), (self.exclusive, self.exclusive_penalty)):
            derivative = self._side(units, first) * self._side(units, second) if curvature > 0 else 1.0
            for row, column in ((first, second), (second, first)):
                found.hessian[:, row, column] += curvature * derivative
        return found

    def _side(self, units: Tensor, columns: Tensor) -> Tensor:
        """The derivative of a control's smoothed distance from neutral, in [-1, 1]."""
        offset = (units - self.neutral)[:, columns]
        return offset / (offset.square() + CORNER**2).sqrt()

    def _prior(self, units: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        cost, gradient, curvature = super()._prior(units)
        offset = units - self.neutral
        size = (offset.square() + CORNER**2).sqrt()
        cost = cost + self._symmetric(offset, gradient, curvature)
        return cost + self._exclusive(offset, size, gradient, curvature), gradient, curvature

    def _symmetric(self, offset: Tensor, gradient: Tensor, curvature: Tensor) -> Tensor:
        first, second = self.symmetric
        difference = offset[:, first] - offset[:, second]
        for columns, sign in ((first, 1.0), (second, -1.0)):
            gradient.index_add_(1, columns, sign * self.symmetric_penalty * difference)
            curvature.index_add_(1, columns, torch.full_like(difference, self.symmetric_penalty))
        return 0.5 * self.symmetric_penalty * difference.square().sum(dim=1)

    def _exclusive(self, offset: Tensor, size: Tensor, gradient: Tensor, curvature: Tensor) -> Tensor:
        """The Hessian of the product is indefinite; that of 0.5 (a + b)^2, its definite part, replaces it."""
        first, second = self.exclusive
        for columns, others in ((first, second), (second, first)):
            gradient.index_add_(1, columns, self.exclusive_penalty * offset[:, columns] / size[:, columns] * size[:, others])
            curvature.index_add_(1, columns, torch.full_like(offset[:, columns], self.exclusive_penalty))
        return self.exclusive_penalty * (size[:, first] * size[:, second]).sum(dim=1)
