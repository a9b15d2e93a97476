"""The least error, mesh by mesh: of meshes that have nothing to do with each other, and of the frames of a clip."""

import torch
from torch import Tensor

from riginv.solvers.levenberg_marquardt import Solution, levenberg_marquardt
from riginv.solvers.objective import Objective
from riginv.solvers.starts import start_at_random, start_by_slope

PIECE = 128  # meshes at a time: what bounds the memory
KEY_DISTANCE = 8  # frames between two that are solved from scratch


def solve_meshes(
    objective: Objective, coordinates: Tensor, starts: int = 3, steps: int = 60, tolerance: float = 1e-4
) -> Solution:
    """Solve from several starts near neutral, and keep the best of each mesh.

    Args:
        coordinates: `(mesh, coordinate)`.
        starts: the first goes by the slope at neutral, the others are strewn around neutral.
        steps, tolerance: as in `levenberg_marquardt`.
    """
    return _in_pieces(objective, coordinates, lambda rows, target: _many_starts(objective, target, starts, steps, tolerance))


def refine_meshes(objective: Objective, coordinates: Tensor, start: Tensor, steps: int) -> Solution:
    """Take a fixed number of steps from a start `(mesh, control)`, such as a network's answer."""
    return _in_pieces(
        objective, coordinates, lambda rows, target: levenberg_marquardt(objective, target, start[rows], steps)
    )


def solve_frames(objective: Objective, coordinates: Tensor, steps: int = 20, more_steps: int = 8, rounds: int = 3) -> Solution:
    """Solve the frames of a clip: some from scratch, the others from their neighbours, then each from whoever does better.

    Args:
        coordinates: `(frame, coordinate)`.
        steps: for frames that start from scratch.
        more_steps: for frames that start from a neighbour's answer.
        rounds: how many times frames may take over from a neighbour that found something better.
    """
    count = len(coordinates)
    found = _empty(objective, coordinates)
    keys = torch.arange(0, count, KEY_DISTANCE)
    _take(found, keys, solve_meshes(objective, coordinates[keys], 1, steps))
    distance = KEY_DISTANCE
    while distance > 1:  # halve the gaps: every new frame lies between two that are solved
        new = torch.arange(distance // 2, count, distance)
        before, after = new - distance // 2, (new + distance // 2).clamp(max=(count - 1) // distance * distance)
        start = (found.units[before] + found.units[after]) / 2
        _take(found, new, refine_meshes(objective, coordinates[new], start, more_steps))
        distance //= 2
    for number in range(rounds):
        reach = 2**(rounds - 1 - number)
        for shift in (reach, -reach):
            _take_over(objective, coordinates, found, shift, more_steps)
    return found


GAIN = 0.02  # of its objective that a frame must gain by a neighbour's answer as it is... 


def _take_over(objective: Objective, coordinates: Tensor, found: Solution, shift: int, steps: int) -> None:
    other = torch.roll(found.units, shift, 0)
    cost = torch.cat([objective.cost(u, c) for u, c in zip(other.split(PIECE), coordinates.split(PIECE))])
    rows = (cost < torch.roll(found.cost, shift, 0) * 0 + found.cost * 1.05).nonzero()[:, 0]
    again = refine_meshes(objective, coordinates[rows], other[rows], steps)
    better = again.cost < found.cost[rows]
    print(shift, len(rows), better.sum(), (found.cost[rows]-again.cost).clamp_min(0).sum()/len(coordinates))
    rows2 = rows[better]
    found.units[rows2], found.cost[rows2] = again.units[better], again.cost[better]
    found.steps[rows] += again.steps


def _many_starts(objective, target, starts, steps, tolerance) -> Solution:
    best = levenberg_marquardt(objective, target, start_by_slope(objective, target), steps, tolerance)
    for number in range(1, starts):
        start = start_at_random(objective, len(target), number)
        other = levenberg_marquardt(objective, target, start, steps, tolerance)
        better = other.cost < best.cost
        best.units = torch.where(better[:, None], other.units, best.units)
        best.cost = torch.where(better, other.cost, best.cost)
        best.steps += other.steps
    return best


def _empty(objective, coordinates) -> Solution:
    n = len(coordinates)
    return Solution(objective.neutral.expand(n, -1).clone(), torch.full((n,), torch.nan), torch.zeros(n, dtype=torch.bool), torch.zeros(n, dtype=torch.long), torch.zeros(n, dtype=torch.bool))


def _take(found: Solution, rows: Tensor, other: Solution) -> None:
    for name in vars(found):
        getattr(found, name)[rows] = getattr(other, name)


def _in_pieces(objective, coordinates, solve) -> Solution:
    found = _empty(objective, coordinates)
    for start in range(0, len(coordinates), PIECE):
        rows = torch.arange(start, min(start + PIECE, len(coordinates)))
        _take(found, rows, solve(rows, coordinates[rows]))
    return found
