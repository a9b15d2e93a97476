"""The least error, mesh by mesh: of meshes that have nothing to do with each other, and of the frames of a clip."""

from collections.abc import Callable

import torch
from torch import Tensor

from riginv.solvers.descent import descend
from riginv.solvers.levenberg_marquardt import TOLERANCE, Solution, levenberg_marquardt
from riginv.solvers.objective import Objective
from riginv.solvers.starts import first_start, start_at_random

BATCH_SIZE = 128  # meshes at a time: what bounds the memory
KEY_DISTANCE = 4  # frames between two that are solved from scratch
EXACT = 1e-5  # mm^2 of half the mean squared distance, 0.005 mm: no other start is tried for a mesh that is hit like that
DESCENT_RATE = 0.03  # of a control's range
PROMISING = 1.05  # a neighbour's answer is worth following up where it costs at most so many times what a frame's own does


def solve_meshes(
    objective: Objective,
    coordinates: Tensor,
    starts: int = 3,
    steps: int = 60,
    tolerance: float = TOLERANCE,
    descent_steps: int = 0,
) -> Solution:
    """Solve from several starts, and keep the best of each mesh; one that is hit exactly is not tried again.

    Args:
        coordinates: `(mesh, coordinate)`.
        starts: the first goes by the rig's features or by the derivative at neutral, the others are strewn around.
        steps, tolerance: as in `levenberg_marquardt`.
        descent_steps: where above 0, the second start is where so many steps of gradient descent lead from the first one.
    """
    rig = objective.rig

    def solve(rows: Tensor) -> Solution:
        target = coordinates[rows]
        first = first_start(objective, target)
        best = levenberg_marquardt(objective, target, first, steps, tolerance)
        for number in range(1, starts):
            open_rows = (best.cost > EXACT * objective.vertex_count).nonzero()[:, 0]
            if not len(open_rows):
                break
            if number == 1 and descent_steps:
                given = objective.own_units(first[open_rows])
                start = objective.units(descend(rig, given, target[open_rows], descent_steps, DESCENT_RATE))
            else:
                start = start_at_random(objective, first, number)[open_rows]
            best.take_better(open_rows, levenberg_marquardt(objective, target[open_rows], start, steps, tolerance))
        return best

    return _in_pieces(objective, len(coordinates), solve)


def refine_meshes(objective: Objective, coordinates: Tensor, start: Tensor, steps: int) -> Solution:
    """Take a few steps, at most, from a start `(mesh, control)` in shares of the ranges, such as a network's answer."""

    def solve(rows: Tensor) -> Solution:
        return levenberg_marquardt(objective, coordinates[rows], start[rows], steps)

    return _in_pieces(objective, len(coordinates), solve)


def solve_frames(
    objective: Objective,
    coordinates: Tensor,
    starts: int = 2,
    steps: int = 30,
    more_steps: int = 3,
    rounds: int = 3,
    descent_steps: int = 0,
) -> Solution:
    """Solve each frame of a clip for itself, at a fraction of what many starts cost: neighbours know good ones.

    Some frames are solved from scratch, those between them from the mean of the answers on either side, and then frames take
    over from a neighbour whose answer serves them well. At last those that have not converged go on until they do.

    Args:
        coordinates: `(frame, coordinate)`.
        starts, steps, descent_steps: for frames that start from scratch, as in `solve_meshes`; those that are still not done
            at the end take as many steps.
        more_steps: for frames that start from a neighbour's answer.
        rounds: how many times frames may take over, from ever nearer neighbours; 0: for a clip that is smoothed afterwards.
    """
    count, distance = len(coordinates), KEY_DISTANCE
    found = Solution.at_neutral(objective, count)
    keys = torch.arange(count, device=coordinates.device)[::distance]
    found.put(keys, solve_meshes(objective, coordinates[keys], starts, steps, descent_steps=descent_steps))
    while distance > 1:
        new = torch.arange(count, device=coordinates.device)[distance // 2 :: distance]
        before, after = new - distance // 2, (new + distance // 2).clamp(max=(count - 1) // distance * distance)
        before, after = (torch.where(found.skipped[one], other, one) for one, other in ((before, after), (after, before)))
        start = (found.units[before] + found.units[after]) / 2
        found.put(new, refine_meshes(objective, coordinates[new], start, more_steps))
        distance //= 2
    for reach in (2**number for number in reversed(range(rounds))):
        for shift in (reach, -reach):
            _take_over(objective, coordinates, found, shift, more_steps)
    if rounds:
        unfinished = (~found.converged & ~found.skipped).nonzero()[:, 0]
        more = refine_meshes(objective, coordinates[unfinished], found.units[unfinished], steps)
        found.take_better(unfinished, more)
    return found


def _take_over(objective: Objective, coordinates: Tensor, found: Solution, shift: int, steps: int) -> None:
    """Let frames go on from the answer of the frame `shift` before them, where that is promising."""
    rows = torch.arange(max(len(coordinates) - abs(shift), 0), device=coordinates.device) + max(shift, 0)
    if not len(rows):
        return
    pieces = zip(found.units[rows - shift].split(BATCH_SIZE), coordinates[rows].split(BATCH_SIZE))
    cost = torch.cat([objective.cost(units, target) for units, target in pieces])
    rows = rows[(cost < PROMISING * found.cost[rows]) & ~found.skipped[rows - shift]]  # NaN is less than nothing
    found.take_better(rows, refine_meshes(objective, coordinates[rows], found.units[rows - shift], steps))


def _in_pieces(objective: Objective, count: int, solve: Callable[[Tensor], Solution]) -> Solution:
    found = Solution.at_neutral(objective, count)
    for rows in torch.arange(count).split(BATCH_SIZE):
        if len(rows):
            found.put(rows, solve(rows))
    return found
