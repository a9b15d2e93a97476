"""What is minimised: the squared distance to a mesh, in mesh coordinates, of controls that run from 0 to 1.

Half the mean squared vertex distance, in mm^2 (constant aside), plus `prior` times half the squared distance from neutral, in
ranges: many rigs have several controls for one motion, and a faint prior says which to prefer. `sparsity` times the distance
itself leaves fewer controls in use. All of it is taken times the number of vertices.
"""

import copy
import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from riginv.networks.features import RigFeatures
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.threads import workers
from riginv.solvers.distance import CORNER_MM, Distance, MeanDistance, squared_distance
from riginv.solvers.weighed_prior import WeighedPrior

PRIOR = 1e-6  # mm^2 for one control that leaves neutral by its whole range: a thousandth of a millimetre everywhere
Result = TypeVar("Result")
SPARSE = 0.1  # the share of entries below which a metric is kept as a sparse matrix
CORNER = 1e-3  # of a range: how round the corner of the distance from neutral is


class Linearised(NamedTuple):
    """The objective near some controls.

    Attributes:
        cost: `(mesh,)`.
        gradient: `(mesh, control)`.
        hessian: the Gauss-Newton one, `(mesh, control, control)`.
    """

    cost: Tensor
    gradient: Tensor
    hessian: Tensor


class Objective:
    """Controls `(mesh, control)` in units of their ranges, 0 at the lower limit and 1 at the upper.

    With the residual e = R (f(r) - f(neutral)) - z and the rig's Jacobian J, the Gauss-Newton Hessian is J^T (R^T R) J: no
    vertex, and no Jacobian of vertices, is ever made.

    Args:
        rig: the rig in its mesh space.
        prior: mm^2 for one control that leaves neutral by its whole range; or as much for each, `(control,)`.
        sparsity: the same, in proportion to the way.
        dtype: to compute in; that of the rig unless given.
        learned: how likely controls are together (`riginv.priors`), on top of these; None: nothing is known.
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        prior: float | Tensor = PRIOR,
        sparsity: float | Tensor = 0.0,
        dtype: torch.dtype | None = None,
        learned: WeighedPrior | None = None,
    ) -> None:
        self.rig = rig
        self.vertex_count = rig.space.vertex_count
        self.prior, self.sparsity = prior * self.vertex_count, sparsity * self.vertex_count
        self.is_sparse = bool(torch.as_tensor(sparsity).any())
        dtype = dtype or rig.linear_map.dtype
        self.map = rig.linear_map.to(dtype)
        self.metric = _metric(rig, self.map)
        self.rest = rig.neutral_coefficients.to(dtype)
        self.learned = None if learned is None else learned.scaled(self.vertex_count, dtype)
        self.distance: Callable[[Tensor], Distance] = squared_distance
        self.lower = rig.rig.lower.to(dtype)
        self.span = rig.rig.upper.to(dtype) - self.lower
        self.neutral = self.units(rig.rig.neutral_controls.to(dtype))

    @property
    def controls(self) -> int:
        return len(self.span)

    @functools.cached_property
    def features(self) -> RigFeatures | None:
        """What the rig can tell of its controls without any search, or None where it offers nothing (`LinearRig.features`)."""
        return RigFeatures.fitted(self.rig) if RigFeatures.offered_by(self.rig) else None

    def by_mean_distance(self, corner_mm: float = CORNER_MM) -> "Objective":
        """The same, where each vertex counts by its distance (`riginv.solvers.distance.MeanDistance`)."""
        other = copy.copy(self)
        other.distance = MeanDistance(self.rig.space.frame.to(self.map), corner_mm)
        return other

    def at_once(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """The results of tasks that ask this objective, as many at once as cores are free and the rig can be asked at once."""
        return workers().run(tasks) if self.rig.rig.differentiable else [task() for task in tasks]

    def units(self, controls: Tensor) -> Tensor:
        """Controls in their own units as shares of their ranges."""
        return (controls.to(self.map) - self.lower) / self.span

    def own_units(self, units: Tensor) -> Tensor:
        """The reverse, exactly within the limits of the rig."""
        rig = self.rig.rig
        return (self.lower + self.span * units).to(rig.dtype).clamp(rig.lower, rig.upper)

    @torch.no_grad()
    def cost(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Tensor:
        """The objective `(mesh,)`, of which no less than 0 can remain.

        Args:
            weights: what the distance of each mesh counts against its preferences, `(mesh,)`; 1 for all unless given.
        """
        found = self.rig.rig.coefficients(self.lower + self.span * units)
        distance = self.distance(self._residual(found, coordinates)).cost
        return (distance if weights is None else weights * distance) + self._preference(units)[0]

    @torch.no_grad()
    def gradient(self, units: Tensor, coordinates: Tensor) -> Tensor:
        """The gradient `(mesh, control)` of the objective."""
        found, pull = self.rig.rig.coefficients_and_pull(self.lower + self.span * units)
        of_residual = self.distance(self._residual(found, coordinates)).pull
        return self.span * pull(of_residual @ self.map.T) + self._preference(units)[1]

    @torch.no_grad()
    def linearise(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Linearised:
        """The objective with its gradient and Gauss-Newton Hessian; weights as in `cost`."""
        found, jacobian = self.rig.rig.coefficient_jacobian(self.lower + self.span * units)
        distance, pull, share = self.distance(self._residual(found, coordinates))
        cost, gradient, curvature = self._preference(units)
        jacobian = jacobian.scaled(self.span)
        hessian = jacobian.gram(self.metric)
        if share is not None:
            hessian = share[:, None, None] * hessian
        derivative = jacobian.pull(pull @ self.map.T)
        if weights is not None:
            distance, derivative, hessian = weights * distance, weights[:, None] * derivative, weights[:, None, None] * hessian
        hessian.diagonal(dim1=1, dim2=2).add_(curvature)
        if self.learned is not None:
            hessian = hessian + self.learned.precision
        return Linearised(cost + distance, gradient + derivative, hessian)

    def _residual(self, coefficients: Tensor, coordinates: Tensor) -> Tensor:
        return (coefficients - self.rest) @ self.map - coordinates

    def _preference(self, units: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Prior and sparsity: their cost `(mesh,)`, gradient and curvature, both `(mesh, control)`.

        A control that is neutral at a limit pays in proportion to its way from there; one that is neutral inside its range by
        a rounded corner, whose curvature is that of the parabola through it which lies nowhere below.
        """
        away = units - self.neutral
        cost, gradient = 0.5 * (self.prior * away.square()).sum(dim=1), self.prior * away
        curvature = torch.zeros_like(away) + self.prior
        if self.learned is not None:  # its curvature is no diagonal: `linearise` adds it
            cost, gradient = cost + self.learned.cost(units), gradient + self.learned.gradient(units)
        if self.is_sparse:
            rounded = (away.square() + CORNER**2).sqrt()
            inside = (self.neutral > 0) & (self.neutral < 1)
            cost = cost + (self.sparsity * torch.where(inside, rounded - CORNER, away.abs())).sum(dim=1)
            direction = torch.where(self.neutral <= 0, 1.0, -1.0)
            gradient = gradient + self.sparsity * torch.where(inside, away / rounded, direction)
            curvature = curvature + self.sparsity * torch.where(inside, 1 / rounded, 0.0)
        return cost, gradient, curvature


def _metric(rig: RigInMeshSpace, linear_map: Tensor) -> Tensor:
    """R^T R `(coefficient, coefficient)`, sparse where few coefficients move vertices in common, as in skinning."""
    moves = rig.rig.basis.abs().flatten(1)
    together = (moves @ moves.T) > 0
    metric = torch.where(together, linear_map @ linear_map.T, 0.0)
    return metric.to_sparse_csr() if together.double().mean() < SPARSE else metric
