"""Where to start from: near neutral, but not on it; or where the rig's own features point.

A control that is neutral inside its range often drives two shapes, one on either side, and its derivative jumps at neutral;
a start on the kink may never leave it. From random places solvers get stuck in a rig's saturations instead.
"""

import torch
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.solvers.objective import Objective

AWAY = 0.02  # of a control's range
BATCH_SIZE = 128
SEED = 20221206


def first_start(objective: Objective, coordinates: Tensor) -> Tensor:
    """Where the rig offers features, what they tell of the controls `(mesh, control)`; else by the derivative at neutral."""
    if objective.features is None:
        return start_by_derivative(objective, coordinates)
    given = coordinates.to(objective.features.scale)
    guess = torch.cat([objective.features.guess(objective.features(piece)) for piece in given.split(BATCH_SIZE)])
    return objective.units(guess).nan_to_num(0.5).clamp(0, 1)


def start_by_derivative(objective: Objective, coordinates: Tensor, away: float = AWAY) -> Tensor:
    """Every control a little away from neutral `(mesh, control)`; one with two sides, on the side that helps the mesh more.

    One that nothing but the prior pulls at stays at neutral.
    """
    neutral = objective.neutral
    above, below = (neutral + away).clamp(0, 1), (neutral - away).clamp(0, 1)
    rise = -objective.gradient(above.expand(len(coordinates), -1), coordinates)
    fall = objective.gradient(below.expand(len(coordinates), -1), coordinates)
    two_sided = (neutral > 0) & (neutral < 1)
    start = torch.where(neutral >= 1, below, torch.where(two_sided & (fall > rise), below, above))
    pull = 2 * objective.prior * away
    return torch.where((rise.abs() <= pull) & (fall.abs() <= pull), neutral, start)


def start_at_random(objective: Objective, first: Tensor, number: int, away: float = AWAY) -> Tensor:
    """Controls `(mesh, control)` strewn around neutral, or around the first start where the rig's features gave it.

    Equal numbers give equal draws, of meshes in the same place.
    """
    neutral = objective.neutral
    offset = away * torch.randn(first.shape, generator=generator_at(SEED, "start", number)).to(neutral)
    if objective.features is not None:
        return (first + offset).clamp(0, 1)
    inward = torch.where(neutral <= 0, offset.abs(), torch.where(neutral >= 1, -offset.abs(), offset))
    return torch.where(first == neutral, neutral, (neutral + inward).clamp(0, 1))  # an idle control stays there
