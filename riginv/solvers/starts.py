"""Where to start from: near neutral, but not on it.

A control that is neutral inside its range often drives two shapes, one on either side, and its slope has a kink at neutral;
a start on the kink may never leave it. From random places solvers get stuck in a rig's saturations instead.
"""

import torch
from torch import Tensor

from riginv.sampling.seeds import generator_at
from riginv.solvers.objective import Objective

AWAY = 0.02  # of a control's range
SEED = 20221206


def start_by_slope(objective: Objective, coordinates: Tensor, away: float = AWAY) -> Tensor:
    """Every control a little away from neutral `(mesh, control)`; one with two sides, on the side that helps the mesh more."""
    neutral = objective.neutral
    above, below = (neutral + away).clamp(0, 1), (neutral - away).clamp(0, 1)
    rise = -objective.gradient(above.expand(len(coordinates), -1), coordinates)
    fall = objective.gradient(below.expand(len(coordinates), -1), coordinates)
    two_sided = (neutral > 0) & (neutral < 1)
    return torch.where(neutral >= 1, below, torch.where(two_sided & (fall > rise), below, above))


def start_at_random(objective: Objective, count: int, number: int, away: float = AWAY) -> Tensor:
    """Controls `(count, control)` strewn around neutral; equal numbers give equal starts, of meshes in the same place."""
    neutral = objective.neutral
    offset = away * torch.randn(count, len(neutral), generator=generator_at(SEED, "start", number)).to(neutral)
    return (neutral + torch.where(neutral <= 0, offset.abs(), torch.where(neutral >= 1, -offset.abs(), offset))).clamp(0, 1)
