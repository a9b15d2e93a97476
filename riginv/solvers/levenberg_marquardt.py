"""Levenberg-Marquardt on many meshes at once, each with damping, acceptance and convergence of its own."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from riginv.solvers.box_step import box_step, damping_diagonal, foreseen_change
from riginv.solvers.objective import Linearised, Objective

START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-7, 1e6
TOLERANCE = 1e-4  # a mesh has converged once steps lower its objective by less than this share
IDLE = 3  # such steps in a row; a step that fails raises the damping and is one of them
LEAST_GAIN = 5e-7  # mm^2 of half the mean squared distance: a step that gains less is the last one, 0.001 mm from the end
REACH = 0.1  # of a control's range, at most in one step: longer ones land in a rig's saturations
FEWEST, MOST = 8, 64  # meshes that one thread solves at a time
TRIES = 3  # of more and more damping on one linearisation, before the step counts as failed


@dataclass
class Solution:
    """Where the solver stopped, for every mesh.

    Attributes:
        units: the controls `(mesh, control)` in shares of their ranges; neutral for meshes that were skipped.
        cost: the objective `(mesh,)`; NaN for meshes that were skipped.
        converged: `(mesh,)`, whether steps gained less than the tolerance, several times in a row.
        steps: linearisations `(mesh,)`.
        skipped: `(mesh,)`, whether the mesh holds NaN or infinite values.
    """

    units: Tensor
    cost: Tensor
    converged: Tensor
    steps: Tensor
    skipped: Tensor

    @classmethod
    def at_neutral(cls, objective: Objective, count: int) -> "Solution":
        """Meshes that nothing has been done for yet."""
        units = objective.neutral.expand(count, -1).clone()
        no, zero = (units.new_zeros(count, dtype=dtype) for dtype in (torch.bool, torch.long))
        return cls(units, torch.full_like(units[:, 0], torch.nan), no, zero, no.clone())

    def put(self, rows: Tensor, other: "Solution") -> None:
        """Let `other` stand for some of the meshes."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)

    def take_better(self, rows: Tensor | slice, other: "Solution") -> None:
        """Take over from `other`, for some of the meshes, what costs less; steps add up."""
        better = other.cost < self.cost[rows]
        for name in ("units", "cost", "converged"):
            mine, theirs = getattr(self, name), getattr(other, name)
            mine[rows] = torch.where(better[:, None] if theirs.ndim == 2 else better, theirs, mine[rows])
        self.steps[rows] += other.steps


def levenberg_marquardt(
    objective: Objective,
    coordinates: Tensor,
    start: Tensor,
    steps: int,
    tolerance: float = TOLERANCE,
    weights: Tensor | None = None,
) -> Solution:
    """Improve controls, mesh by mesh, each within the limits; meshes that have converged cost no more time.

    Args:
        coordinates: the meshes in mesh space, `(mesh, coordinate)`; those with NaN or infinite values are skipped.
        start: `(mesh, control)` in shares of their ranges.
        steps: linearisations, at most.
        tolerance: a mesh has converged once a step lowers its objective by less than this share, three times in a row, or by
            next to nothing.
        weights: what the distance of each mesh counts against prior and sparsity, `(mesh,)`; 1 for all unless given.
    """
    coordinates = coordinates.to(start)
    given = (coordinates, start) if weights is None else (coordinates, start, weights)
    size = max(FEWEST, min(MOST, -(-len(start) // 2)))
    parts = list(zip(*(values.split(size) for values in given)))
    found = objective.at_once(
        [lambda part=part: _solve(objective, part[0], part[1], steps, tolerance, *part[2:]) for part in parts]
    )
    return Solution(**{name: torch.cat([getattr(part, name) for part in found]) for name in vars(found[0])})


@torch.no_grad()
def _solve(
    objective: Objective, coordinates: Tensor, start: Tensor, steps: int, tolerance: float, weights: Tensor | None = None
) -> Solution:
    skipped = ~torch.isfinite(coordinates).all(dim=1)
    best = torch.where(skipped[:, None], objective.neutral, start.clamp(0, 1))
    cost = torch.full_like(best[:, 0], torch.nan)
    converged, taken = torch.zeros_like(skipped), torch.zeros_like(skipped, dtype=torch.long)
    damping, idle = torch.full_like(cost, START_DAMPING), torch.zeros_like(taken)
    active = (~skipped).nonzero()[:, 0]

    def wanted(rows: Tensor) -> tuple[Tensor, ...]:
        return (coordinates[rows],) if weights is None else (coordinates[rows], weights[rows])

    for _ in range(steps):
        if not len(active):
            break
        target = wanted(active)
        near = objective.linearise(best[active], *target)
        moved, found, chosen = _improve(objective, near, best[active], target, damping[active])
        gained = near.cost - found
        best[active], cost[active], damping[active] = moved, found, chosen
        taken[active] += 1
        small = gained <= tolerance * near.cost
        idle[active] = torch.where(small, idle[active] + 1, 0)
        last = (gained > 0) & (gained <= LEAST_GAIN * objective.vertex_count)
        converged[active] = last | (idle[active] >= IDLE) | (small & (chosen >= MOST_DAMPING))
        active = active[~converged[active]]
    if len(unknown := (torch.isnan(cost) & ~skipped).nonzero()[:, 0]):  # no step was asked for
        cost[unknown] = objective.cost(best[unknown], *wanted(unknown))
    return Solution(best, cost, converged, taken, skipped)


def _improve(
    objective: Objective, near: Linearised, at: Tensor, target: tuple[Tensor, ...], damping: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Try a step, and with more damping again where it does not help: controls, costs, and dampings to go on with."""
    moved, cost, damping = at.clone(), near.cost.clone(), damping.clone()
    trying = torch.arange(len(at), device=at.device)
    raise_by = 4.0
    for _ in range(TRIES):
        gradient, hessian = near.gradient[trying], near.hessian[trying]
        step = box_step(hessian, gradient, at[trying], damping_diagonal(hessian, damping[trying])).clamp(-REACH, REACH)
        found = objective.cost(at[trying] + step, *(values[trying] for values in target))
        foreseen = -foreseen_change(hessian, gradient, step)
        better = found < cost[trying]
        kept = trying[better]
        ratio = ((near.cost[kept] - found[better]) / foreseen[better].clamp_min(torch.finfo(at.dtype).tiny)).clamp(max=1.5)
        damping[kept] *= (1 - (2 * ratio - 1) ** 3).clamp(0.1, 3.0)  # Nielsen's rule
        moved[kept], cost[kept] = at[kept] + step[better], found[better]
        trying = trying[~better]
        if not len(trying):
            break
        damping[trying] *= raise_by
        raise_by *= 4
    return moved, cost, damping.clamp(LEAST_DAMPING, MOST_DAMPING)
