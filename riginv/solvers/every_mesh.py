"""Solving meshes independently: unrelated ones, and the frames of a clip with starts from their neighbours."""

from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from riginv.solvers.box_step import box_step
from riginv.solvers.levenberg_marquardt import FAR, NEAR, TOLERANCE, Pace, Solution, levenberg_marquardt
from riginv.solvers.objective import Objective
from riginv.solvers.starts import descend, first_start, start_at_random

BATCH_SIZE = 128  # bounds the memory
KEY_DISTANCE = 4  # step of the frames that are solved from scratch
EXACT = 1e-5  # mm^2 of half the mean squared distance, 0.005 mm: below it no other start is tried
DESCENT_RATE = 0.03  # as a fraction of a control's range
MEAN_STEPS, MEAN_RATE, MEAN_CORNER_MM = 100, 0.02, 0.01  # of the descent on the mean distance: ten times the steps gain 0.2 %
# Of `mean_distance_steps`; 2,048 vertices take three times as long for 0.3 % of error.
STEP_CORNER_MM, STEP_VERTICES = 0.1, 1024
STEP_DAMPING_MM2, FIXED = 0.3, 1e6  # for a whole range; a factor that leaves a control where it is
PROMISING = 1.05  # a neighbour's solution is tried where it costs at most this multiple of the frame's own


def solve_meshes(
    objective: Objective,
    coordinates: Float[Tensor, "mesh coordinate"],
    starts: int = 3,
    steps: int = 60,
    tolerance: float = TOLERANCE,
    descent_steps: int = 0,
) -> Solution:
    """Solve from several starts, and keep the best solution of each mesh; one that is exact is not solved again.

    Args:
        starts: their number; the first is `first_start`, the others are random.
        steps, tolerance: as in `levenberg_marquardt`.
        descent_steps: if above 0, the second start is the first one after so many steps of gradient descent.
    """
    rig = objective.rig

    def solve(rows: Tensor) -> Solution:
        target = coordinates[rows]
        first = first_start(objective, target)
        best = levenberg_marquardt(objective, target, first, steps, tolerance)
        for number in range(1, starts):
            open_rows = (best.cost > EXACT * objective.squared_mm).nonzero()[:, 0]
            if not len(open_rows):
                break
            if number == 1 and descent_steps:
                controls = objective.to_controls(first[open_rows])
                start = objective.units(descend(rig, controls, target[open_rows], descent_steps, DESCENT_RATE))
            else:
                start = start_at_random(objective, first, number)[open_rows]
            best.take_better(open_rows, levenberg_marquardt(objective, target[open_rows], start, steps, tolerance))
        return best

    return _in_batches(objective, len(coordinates), solve)


def refine_meshes(
    objective: Objective,
    coordinates: Float[Tensor, "mesh coordinate"],
    start: Float[Tensor, "mesh control"],
    steps: int,
    pace: Pace = FAR,
) -> Solution:
    """Take at most `steps` from a start `(mesh, control)`, as fractions of the ranges, such as a network's output."""

    def solve(rows: Tensor) -> Solution:
        return levenberg_marquardt(objective, coordinates[rows], start[rows], steps, pace=pace)

    return _in_batches(objective, len(coordinates), solve)


def descend_mean_distance(
    objective: Objective, coordinates: Float[Tensor, "mesh coordinate"], start: Float[Tensor, "mesh control"]
) -> Float[Tensor, "mesh control"]:
    """Gradient descent on the mean vertex distance from a solution of least squares; both as fractions of the ranges."""
    distance, controls = objective.by_mean_distance(MEAN_CORNER_MM).distance, objective.to_controls(start)
    batches = zip(controls.split(BATCH_SIZE), coordinates.to(controls).split(BATCH_SIZE))
    descended = [
        descend(objective.rig, batch, target, MEAN_STEPS, MEAN_RATE, distance, anneal=True) for batch, target in batches
    ]
    return objective.units(torch.cat(descended))


def mean_distance_steps(
    objective: Objective,
    coordinates: Float[Tensor, "mesh coordinate"],
    start: Float[Tensor, "mesh control"],
    steps: int,
    fixed: Bool[Tensor, " control"] | None = None,
) -> Float[Tensor, "mesh control"]:
    """Damped Gauss-Newton steps on the mean vertex distance from a network's answer; both as fractions of the ranges.

    Damping is constant and no step is searched for its length: so neighbouring frames get similar steps, and curves stay as
    smooth as the network's.

    Args:
        fixed: controls that keep their value; None: none.
    """
    objective = objective.by_mean_distance(STEP_CORNER_MM, STEP_VERTICES)
    damping = torch.full_like(objective.neutral, STEP_DAMPING_MM2 * objective.squared_mm)
    if fixed is not None:
        damping = torch.where(fixed, FIXED * damping, damping)

    def solve(units: Tensor, target: Tensor) -> Tensor:
        for _ in range(steps):
            near = objective.linearise(units, target)
            units = units + box_step(near.hessian, near.gradient, units, damping.expand_as(units))
        return units

    batches = zip(start.clamp(0, 1).split(BATCH_SIZE), coordinates.to(start).split(BATCH_SIZE))
    return torch.cat(objective.run_tasks([partial(solve, *batch) for batch in batches]))


def solve_frames(
    objective: Objective,
    coordinates: Float[Tensor, "frame coordinate"],
    starts: int = 2,
    steps: int = 30,
    more_steps: int = 3,
    rounds: int = 3,
    descent_steps: int = 0,
    key_distance: int = KEY_DISTANCE,
) -> Solution:
    """Solve each frame of a clip independently, with starts from neighbours: cheaper than many starts.

    Some frames are solved from scratch, those between them from the mean of the solutions on either side. Then frames restart
    from neighbours' solutions that are promising. Last, frames that have not converged are continued.

    Args:
        starts, steps, descent_steps: for frames that start from scratch, as in `solve_meshes`; `steps` also for those that are
            continued in the end.
        more_steps: for frames that start from a neighbour's solution.
        rounds: of restarts, from ever nearer neighbours; 0: for a clip that is smoothed afterwards.
        key_distance: step of the frames that are solved from scratch, a power of 2.
    """
    count, distance = len(coordinates), key_distance
    solution = Solution.at_neutral(objective, count)
    keys = torch.arange(count, device=coordinates.device)[::distance]
    solution.put(keys, solve_meshes(objective, coordinates[keys], starts, steps, descent_steps=descent_steps))
    while distance > 1:
        new = torch.arange(count, device=coordinates.device)[distance // 2 :: distance]
        before, after = new - distance // 2, (new + distance // 2).clamp(max=(count - 1) // distance * distance)
        before, after = (torch.where(solution.skipped[side], other, side) for side, other in ((before, after), (after, before)))
        start = (solution.units[before] + solution.units[after]) / 2
        solution.put(new, refine_meshes(objective, coordinates[new], start, more_steps))
        distance //= 2
    for distance in (2**number for number in reversed(range(rounds))):
        for shift in (distance, -distance):
            _restart(objective, coordinates, solution, shift, more_steps)
    if rounds:
        unfinished = (~solution.converged & ~solution.skipped).nonzero()[:, 0]
        continued = refine_meshes(objective, coordinates[unfinished], solution.units[unfinished], steps)
        solution.take_better(unfinished, continued)
    return solution


def solve_from_guess(
    objective: Objective, coordinates: Float[Tensor, "frame coordinate"], guess: Float[Tensor, "frame control"], steps: int
) -> Solution:
    """Solve each frame of a clip from a guess `(frame, control)` near the solution, as fractions of the ranges.

    Frames that do not become exact restart from their neighbours' solutions, from both sides.
    """
    found = refine_meshes(objective, coordinates, guess, steps, NEAR)
    for start, pace in (("before", NEAR), ("after", NEAR), ("guess", FAR)):
        distance = found.cost - objective.prior_cost(found.units)
        rows = (distance > EXACT * objective.squared_mm).nonzero()[:, 0]
        if not len(rows):
            break
        others = rows - 1 if start == "before" else rows + 1
        units = guess[rows] if start == "guess" else found.units[others.clamp(0, len(guess) - 1)]
        found.take_better(rows, refine_meshes(objective, coordinates[rows], units, steps, pace))
    return found


def _restart(objective: Objective, coordinates: Tensor, found: Solution, shift: int, steps: int) -> None:
    """Restart frames from the solution of the frame `shift` before them, where that is promising."""
    rows = torch.arange(max(len(coordinates) - abs(shift), 0), device=coordinates.device) + max(shift, 0)
    if not len(rows):
        return
    batches = zip(found.units[rows - shift].split(BATCH_SIZE), coordinates[rows].split(BATCH_SIZE))
    cost = torch.cat([objective.cost(units, target) for units, target in batches])
    rows = rows[(cost < PROMISING * found.cost[rows]) & ~found.skipped[rows - shift]]  # comparisons with NaN are false
    found.take_better(rows, refine_meshes(objective, coordinates[rows], found.units[rows - shift], steps))


def _in_batches(objective: Objective, count: int, solve: Callable[[Tensor], Solution]) -> Solution:
    found = Solution.at_neutral(objective, count)
    for rows in torch.arange(count).split(BATCH_SIZE):
        if len(rows):
            found.put(rows, solve(rows))
    return found
