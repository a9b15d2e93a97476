"""The objective of all solvers: the squared distance to a mesh plus a prior, of controls as fractions of their ranges.

Half the mean squared vertex distance, in mm^2 (up to a constant), plus `prior` times half the squared distance of the controls
from neutral, which decides between several controls of one motion, plus `sparsity` times that distance itself, for fewer active
controls. All terms are multiplied by the number of vertices.
"""

import copy
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from riginv.networks.features import RigFeatures
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.threads import workers
from riginv.solvers.distance import CORNER_MM, VERTICES, Distance, MeanDistance, squared_distance


@dataclass(frozen=True)
class GaussianPrior:
    """A Gaussian prior: 0.5 (u - mean)^T precision (u - mean), mm^2, of controls u as fractions of their ranges.

    Attributes:
        mean: `(control,)`.
        precision: `(control, control)`, mm^2.
    """

    mean: Tensor
    precision: Tensor

    def scaled(self, factor: float, dtype: torch.dtype) -> "GaussianPrior":
        """The same prior, times a factor, in a dtype."""
        return GaussianPrior(self.mean.to(dtype), (factor * self.precision).to(dtype))

    def cost(self, units: Float[Tensor, "mesh control"]) -> Float[Tensor, " mesh"]:
        """The cost `(mesh,)` of controls `(mesh, control)`."""
        away = units - self.mean.to(units)
        return 0.5 * (away * (away @ self.precision.to(units))).sum(dim=-1)

    def gradient(self, units: Float[Tensor, "mesh control"]) -> Float[Tensor, "mesh control"]:
        """The gradient `(mesh, control)`."""
        return (units - self.mean.to(units)) @ self.precision.to(units)


PRIOR = 1e-6  # mm^2 for one control at its whole range from neutral: as 0.001 mm at every vertex
Result = TypeVar("Result")
SPARSE = 0.1  # density below which a metric is stored as a sparse matrix
CORNER = 1e-3  # of the rounded distance from neutral, as a fraction of a range


class Linearised(NamedTuple):
    """The objective with its derivatives at some controls.

    Attributes:
        cost: `(mesh,)`.
        gradient: `(mesh, control)`.
        hessian: the Gauss-Newton one, `(mesh, control, control)`.
    """

    cost: Tensor
    gradient: Tensor
    hessian: Tensor


class Objective:
    """The objective of controls `(mesh, control)`, as fractions of their ranges: 0 at the lower limit, 1 at the upper.

    With the residual e = R (f(r) - f(neutral)) - z and the rig's Jacobian J, the Gauss-Newton Hessian is J^T (R^T R) J:
    neither vertices nor their Jacobian are computed.

    Args:
        rig: the rig in its mesh space.
        prior: mm^2 for one control at its whole range from neutral; for all or for each, `(control,)`.
        sparsity: the same, proportional to the distance from neutral.
        dtype: of the computation; None: the rig's.
        learned: a further prior on combinations of controls (`riginv.tracking.priors`).
    """

    def __init__(
        self,
        rig: RigInMeshSpace,
        prior: float | Tensor = PRIOR,
        sparsity: float | Tensor = 0.0,
        dtype: torch.dtype | None = None,
        learned: GaussianPrior | None = None,
    ) -> None:
        self.rig = rig
        self.vertex_count = rig.space.vertex_count
        self.squared_mm = self.vertex_count * rig.source.length_scale**2  # a mean squared distance of 1 mm^2
        self.gradient_steps = rig.source.gradient_steps
        self.prior, self.sparsity = prior * self.squared_mm, sparsity * self.squared_mm
        self.is_sparse = bool(torch.as_tensor(sparsity).any())
        dtype = dtype or rig.linear_map.dtype
        self.map = rig.linear_map.to(dtype)
        self.rest = rig.neutral_coefficients.to(dtype)
        self.learned = None if learned is None else learned.scaled(self.vertex_count, dtype)
        self.distance: Callable[[Tensor], Distance] = squared_distance
        self.lower = rig.source.lower.to(dtype)
        self.span = rig.source.upper.to(dtype) - self.lower
        self.neutral = self.units(rig.source.neutral_controls.to(dtype))

    @property
    def controls(self) -> int:
        return len(self.span)

    @functools.cached_property
    def metric(self) -> Tensor:
        """R^T R `(coefficient, coefficient)`, sparse where few coefficients move common vertices, as in skinning."""
        together = _move_together(self.rig.source.basis.flatten(1))
        metric = torch.where(together, self.map @ self.map.T, 0.0)
        return metric.to_sparse_csr() if together.double().mean() < SPARSE else metric

    @functools.cached_property
    def features(self) -> RigFeatures | None:
        """The rig's calibrated features (`LinearRig.features`), or coefficients of a fitted basis; None: it has neither."""
        return RigFeatures.fitted(self.rig) if RigFeatures.offered_by(self.rig) else None

    def by_mean_distance(self, corner_mm: float = CORNER_MM, vertices: int = VERTICES) -> "Objective":
        """The same objective with the mean distance in place of the mean squared distance (`MeanDistance`)."""
        _ = self.metric  # computed before it is copied: once, not in every copy
        other = copy.copy(self)
        other.distance = MeanDistance(self.rig.space.directions.to(self.map), corner_mm, vertices)
        return other

    def run_tasks(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """The results of tasks that evaluate this objective, in parallel on a CPU if the rig allows it and cores are free."""
        in_parallel = self.rig.source.differentiable and self.map.device.type == "cpu"
        return workers().run(tasks) if in_parallel else [task() for task in tasks]

    def units(self, controls: Tensor) -> Tensor:
        """Controls as fractions of their ranges."""
        return (controls.to(self.map) - self.lower) / self.span

    def to_controls(self, units: Tensor) -> Tensor:
        """The inverse of `units`, exactly within the limits of the rig."""
        rig = self.rig.source
        return (self.lower + self.span * units).to(rig.dtype).clamp(rig.lower, rig.upper)

    @torch.no_grad()
    def cost(
        self,
        units: Float[Tensor, "mesh control"],
        coordinates: Float[Tensor, "mesh coordinate"],
        weights: Float[Tensor, " mesh"] | None = None,
    ) -> Float[Tensor, " mesh"]:
        """The objective `(mesh,)`, at least 0.

        Args:
            weights: of each mesh's distance against the priors; None: 1.
        """
        found = self.rig.source.coefficients(self.lower + self.span * units)
        distance = self.distance(self._residual(found, coordinates)).cost
        return (distance if weights is None else weights * distance) + self._prior(units)[0]

    @torch.no_grad()
    def prior_cost(self, units: Float[Tensor, "mesh control"]) -> Float[Tensor, " mesh"]:
        """The part of the objective `(mesh,)` that does not depend on the mesh."""
        return self._prior(units)[0]

    @torch.no_grad()
    def gradient(
        self, units: Float[Tensor, "mesh control"], coordinates: Float[Tensor, "mesh coordinate"]
    ) -> Float[Tensor, "mesh control"]:
        """The gradient `(mesh, control)` of the objective."""
        found, vjp = self.rig.source.coefficients_and_vjp(self.lower + self.span * units)
        by_residual = self.distance(self._residual(found, coordinates)).gradient
        return self.span * vjp(by_residual @ self.map.T) + self._prior(units)[1]

    @torch.no_grad()
    def linearise(
        self,
        units: Float[Tensor, "mesh control"],
        coordinates: Float[Tensor, "mesh coordinate"],
        weights: Float[Tensor, " mesh"] | None = None,
    ) -> Linearised:
        """The objective with its gradient and Gauss-Newton Hessian; weights as in `cost`."""
        distance, derivative, hessian = self._linearise_data(units, coordinates)
        cost, gradient, curvature = self._prior(units)
        if weights is not None:
            distance, derivative, hessian = weights * distance, weights[:, None] * derivative, weights[:, None, None] * hessian
        hessian.diagonal(dim1=1, dim2=2).add_(curvature)
        if self.learned is not None:
            hessian = hessian + self.learned.precision
        return Linearised(cost + distance, gradient + derivative, hessian)

    def _linearise_data(self, units: Tensor, coordinates: Tensor) -> Linearised:
        """The distance alone, without priors."""
        found, jacobian = self.rig.source.coefficient_jacobian(self.lower + self.span * units)
        distance, by_residual, relative = self.distance(self._residual(found, coordinates))
        jacobian = jacobian.scaled(self.span)
        hessian = jacobian.gram(self.metric)
        if relative is not None:
            hessian = relative[:, None, None] * hessian
        return Linearised(distance, jacobian.vjp(by_residual @ self.map.T), hessian)

    def _residual(self, coefficients: Tensor, coordinates: Tensor) -> Tensor:
        return (coefficients - self.rest) @ self.map - coordinates

    def _prior(self, units: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Prior and sparsity: their cost `(mesh,)`, gradient and curvature, both `(mesh, control)`."""
        away = units - self.neutral
        cost, gradient = 0.5 * (self.prior * away.square()).sum(dim=1), self.prior * away
        curvature = torch.zeros_like(away) + self.prior
        if self.learned is not None:  # its curvature is not diagonal: `linearise` adds it
            cost, gradient = cost + self.learned.cost(units), gradient + self.learned.gradient(units)
        if self.is_sparse:
            terms = sparsity_terms(units, self.neutral, self.sparsity)
            cost, gradient, curvature = cost + terms[0], gradient + terms[1], curvature + terms[2]
        return cost, gradient, curvature


def sparsity_terms(units: Tensor, neutral: Tensor, sparsity: float | Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """An L1 penalty on controls `(mesh, control)`: its cost `(mesh,)`, gradient and curvature, both `(mesh, control)`.

    That of a control that is neutral at a limit is linear; inside its range it is rounded at neutral, with the curvature of the
    parabola that bounds it from above.
    """
    away = units - neutral
    rounded = (away.square() + CORNER**2).sqrt()
    inside = (neutral > 0) & (neutral < 1)
    cost = (sparsity * torch.where(inside, rounded - CORNER, away.abs())).sum(dim=1)
    direction = torch.where(neutral <= 0, 1.0, -1.0)
    gradient = sparsity * torch.where(inside, away / rounded, direction)
    return cost, gradient, sparsity * torch.where(inside, 1 / rounded, 0.0)


def _move_together(rows: Tensor) -> Tensor:
    """Whether two rows `(row, number)` are both other than 0 anywhere, `(row, row)`."""
    moves = rows != 0
    if rows.device.type != "cpu":
        return (moves.to(rows.dtype) @ moves.to(rows.dtype).T) > 0
    bits = np.packbits(moves.numpy(), axis=1)  # far fewer operations than a product of the rows
    words = np.pad(bits, ((0, 0), (0, -bits.shape[1] % 8))).view(np.uint64)
    return torch.from_numpy(np.stack([(words & row).any(axis=1) for row in words]))
