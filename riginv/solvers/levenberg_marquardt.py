"""Levenberg-Marquardt on many meshes at once, each with its own damping, acceptance and convergence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import NamedTuple, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.solvers.box_step import box_step, damping_diagonal, predicted_change
from riginv.solvers.objective import Linearised, Result

START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-7, 1e6
TOLERANCE = 1e-4  # a step that reduces the objective by less than this fraction counts as idle
IDLE = 3  # consecutive idle steps until a mesh has converged; failed steps count
LEAST_GAIN = 5e-7  # mm^2 of half the mean squared distance, 0.001 mm: a step that gains less is the last one
LONGEST_STEP = 0.1  # as a fraction of a control's range: longer ones end in a rig's saturations
FEWEST, MOST = 8, 64  # meshes that one thread solves at a time
TRIES = 3  # of increasing damping on one linearisation, before the step has failed


class Pace(NamedTuple):
    """Step limits and convergence tolerances of Levenberg-Marquardt.

    Attributes:
        damping: of the first step.
        longest_step: of each control, as a fraction of its range.
        enough: half the mean squared distance, mm^2, below which a mesh has converged; 0: there is no such threshold.
    """

    damping: float = START_DAMPING
    longest_step: float = LONGEST_STEP
    enough: float = 0.0


FAR, NEAR = Pace(), Pace(1e-4, 0.3, LEAST_GAIN)  # the start is anywhere, or near the solution


class Minimised(Protocol):
    """What Levenberg-Marquardt minimises: an `Objective`, or variables of one; see there."""

    neutral: Tensor
    squared_mm: float
    gradient_steps: int

    def run_tasks(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]: ...
    def cost(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Tensor: ...
    def prior_cost(self, units: Tensor) -> Tensor: ...
    def gradient(self, units: Tensor, coordinates: Tensor) -> Tensor: ...
    def linearise(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Linearised: ...


@dataclass
class Solution:
    """The solver's result for every mesh.

    Attributes:
        units: the controls `(mesh, control)`, as fractions of their ranges; neutral for skipped meshes.
        cost: the objective `(mesh,)`; NaN for skipped meshes.
        converged: `(mesh,)`.
        steps: number of linearisations, `(mesh,)`; the steps that follow each with a new gradient alone are not counted.
        skipped: `(mesh,)`, whether the mesh has NaN or infinite values.
    """

    units: Tensor
    cost: Tensor
    converged: Tensor
    steps: Tensor
    skipped: Tensor

    @classmethod
    def at_neutral(cls, objective: Minimised, count: int) -> "Solution":
        """The solution before any step: neutral controls and unknown costs."""
        units = objective.neutral.expand(count, -1).clone()
        no, zero = (units.new_zeros(count, dtype=dtype) for dtype in (torch.bool, torch.long))
        return cls(units, torch.full_like(units[:, 0], torch.nan), no, zero, no.clone())

    def put(self, rows: Tensor, other: "Solution") -> None:
        """Replace the solutions of some meshes by `other`."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)

    def take_better(self, rows: Tensor | slice, other: "Solution") -> None:
        """Replace the solutions of some meshes by `other` where it costs less; steps add up."""
        better = other.cost < self.cost[rows]
        for name in ("units", "cost", "converged"):
            mine, theirs = getattr(self, name), getattr(other, name)
            mine[rows] = torch.where(better[:, None] if theirs.ndim == 2 else better, theirs, mine[rows])
        self.steps[rows] += other.steps


def levenberg_marquardt(
    objective: Minimised,
    coordinates: Float[Tensor, "mesh coordinate"],
    start: Float[Tensor, "mesh control"],
    steps: int,
    tolerance: float = TOLERANCE,
    weights: Float[Tensor, " mesh"] | None = None,
    pace: Pace = FAR,
) -> Solution:
    """Minimise the objective of each mesh from a start, within the controls' limits.

    Args:
        coordinates: of the meshes; those with NaN or infinite values are skipped.
        start: as fractions of the ranges.
        steps: the greatest number of linearisations.
        tolerance: a mesh has converged once three consecutive steps reduce its objective by less than this fraction.
        weights: of each mesh's distance against prior and sparsity; None: 1.
        pace: `NEAR` for starts that are known to be near the solution.
    """
    coordinates = coordinates.to(start)
    arguments = (coordinates, start) if weights is None else (coordinates, start, weights)
    size = max(FEWEST, min(MOST, -(-len(start) // 2)))
    batches = zip(*(values.split(size) for values in arguments))
    solutions = objective.run_tasks([partial(_solve, objective, steps, tolerance, pace, *batch) for batch in batches])
    return Solution(**{name: torch.cat([getattr(solution, name) for solution in solutions]) for name in vars(solutions[0])})


@torch.no_grad()
def _solve(
    objective: Minimised,
    steps: int,
    tolerance: float,
    pace: Pace,
    coordinates: Tensor,
    start: Tensor,
    weights: Tensor | None = None,
) -> Solution:
    skipped = ~torch.isfinite(coordinates).all(dim=1)
    best = torch.where(skipped[:, None], objective.neutral, start.clamp(0, 1))
    cost = torch.full_like(best[:, 0], torch.nan)
    converged, step_counts = torch.zeros_like(skipped), torch.zeros_like(skipped, dtype=torch.long)
    damping, idle = torch.full_like(cost, pace.damping), torch.zeros_like(step_counts)
    active = (~skipped).nonzero()[:, 0]

    def targets(rows: Tensor) -> tuple[Tensor, ...]:
        return (coordinates[rows],) if weights is None else (coordinates[rows], weights[rows])

    for _ in range(steps):
        if not len(active):
            break
        target = targets(active)
        near = objective.linearise(best[active], *target)
        new_units, new_cost, new_damping = _improve(objective, near, best[active], target, damping[active], pace.longest_step)
        for _ in range(objective.gradient_steps if weights is None else 0):
            near_new = near._replace(cost=new_cost, gradient=objective.gradient(new_units, *target))
            arguments = (new_units, target, new_damping, pace.longest_step)
            new_units, new_cost, new_damping = _improve(objective, near_new, *arguments)
        gained = near.cost - new_cost
        best[active], cost[active], damping[active] = new_units, new_cost, new_damping
        step_counts[active] += 1
        small = gained <= tolerance * near.cost
        idle[active] = torch.where(small, idle[active] + 1, 0)
        last = (gained > 0) & (gained <= LEAST_GAIN * objective.squared_mm)
        if pace.enough:
            last |= new_cost - objective.prior_cost(new_units) <= pace.enough * objective.squared_mm
        converged[active] = last | (idle[active] >= IDLE) | (small & (new_damping >= MOST_DAMPING))
        active = active[~converged[active]]
    if len(unknown := (torch.isnan(cost) & ~skipped).nonzero()[:, 0]):  # with 0 steps
        cost[unknown] = objective.cost(best[unknown], *targets(unknown))
    return Solution(best, cost, converged, step_counts, skipped)


def _improve(
    objective: Minimised, near: Linearised, at: Tensor, target: tuple[Tensor, ...], damping: Tensor, longest: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Try a step, again with more damping where it fails: the new controls, costs and dampings."""
    moved, cost, damping, every = at.clone(), near.cost.clone(), damping.clone(), target
    trying = torch.arange(len(at), device=at.device)
    gradient, hessian, start, raise_by = near.gradient, near.hessian, at, 4.0
    for number in range(TRIES):
        if number:
            gradient, hessian, start = near.gradient[trying], near.hessian[trying], at[trying]
            target = tuple(values[trying] for values in every)
        step = box_step(hessian, gradient, start, damping_diagonal(hessian, damping[trying])).clamp(-longest, longest)
        found = objective.cost(start + step, *target)
        predicted = -predicted_change(hessian, gradient, step)
        better = found < cost[trying]
        kept = trying[better]
        ratio = ((near.cost[kept] - found[better]) / predicted[better].clamp_min(torch.finfo(at.dtype).tiny)).clamp(max=1.5)
        damping[kept] *= (1 - (2 * ratio - 1) ** 3).clamp(0.1, 3.0)  # Nielsen's rule
        moved[kept], cost[kept] = (start + step)[better], found[better]
        trying = trying[~better]
        if not len(trying):
            break
        damping[trying] *= raise_by
        raise_by *= 4
    return moved, cost, damping.clamp(LEAST_DAMPING, MOST_DAMPING)
