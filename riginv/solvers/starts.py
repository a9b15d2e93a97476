"""Starts of the solvers: a guess from the rig's features, or controls near neutral.

A control that is neutral inside its range often drives two shapes, one on either side, and its derivative jumps at neutral, so
that a start there may get stuck. From random controls solvers get stuck in a rig's saturations instead.
"""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.distance import Distance, squared_distance
from riginv.solvers.objective import Objective

OFFSET = 0.02  # from neutral, as a fraction of a control's range
BATCH_SIZE = 128
SEED = 20221206
MEMORY, SQUARE_MEMORY, SMALLEST = 0.9, 0.999, 1e-8  # of Adam


def first_start(objective: Objective, coordinates: Float[Tensor, "mesh coordinate"]) -> Float[Tensor, "mesh control"]:
    """The guess `(mesh, control)` from the rig's features, continuous over consecutive meshes; else `start_by_derivative`."""
    if objective.features is None:
        return start_by_derivative(objective, coordinates)
    given = coordinates.to(objective.features.scale)
    guess = torch.cat([objective.features.guess(objective.features(batch)) for batch in given.split(BATCH_SIZE)])
    return objective.units(objective.rig.source.continuous(guess)).nan_to_num(0.5).clamp(0, 1)


def start_by_derivative(
    objective: Objective, coordinates: Float[Tensor, "mesh coordinate"], offset: float = OFFSET
) -> Float[Tensor, "mesh control"]:
    """Controls `(mesh, control)` at a small offset from neutral, on the side with the greater descent.

    Controls whose gradient is that of the prior alone stay neutral.
    """
    neutral = objective.neutral
    above, below = (neutral + offset).clamp(0, 1), (neutral - offset).clamp(0, 1)
    rise = -objective.gradient(above.expand(len(coordinates), -1), coordinates)
    fall = objective.gradient(below.expand(len(coordinates), -1), coordinates)
    two_sided = (neutral > 0) & (neutral < 1)
    start = torch.where(neutral >= 1, below, torch.where(two_sided & (fall > rise), below, above))
    idle = 2 * objective.prior * offset
    return torch.where((rise.abs() <= idle) & (fall.abs() <= idle), neutral, start)


def start_at_random(
    objective: Objective, first: Float[Tensor, "mesh control"], number: int, spread: float = OFFSET
) -> Float[Tensor, "mesh control"]:
    """Random controls `(mesh, control)` around neutral, or around the first start if it is from the rig's features.

    The draws depend on `number` and on each mesh's index.
    """
    neutral = objective.neutral
    offset = spread * torch.randn(first.shape, generator=generator_at(SEED, "start", number)).to(neutral)
    if objective.features is not None:
        return (first + offset).clamp(0, 1)
    inward = torch.where(neutral <= 0, offset.abs(), torch.where(neutral >= 1, -offset.abs(), offset))
    return torch.where(first == neutral, neutral, (neutral + inward).clamp(0, 1))  # an idle control stays there


def descend(
    rig: RigInMeshSpace,
    start: Float[Tensor, "mesh control"],
    coordinates: Float[Tensor, "mesh coordinate"],
    steps: int,
    lr: float,
    distance: Callable[[Tensor], Distance] = squared_distance,
    anneal: bool = False,
) -> Float[Tensor, "mesh control"]:
    """Adam on the distance to meshes, within the controls' limits.

    Args:
        start: controls.
        lr: step size, as a fraction of a control's range.
        distance: of residuals `(mesh, coordinate)`.
        anneal: whether the step size falls to 0, by a cosine.

    Returns:
        The best controls `(mesh, control)` of all steps; the start for meshes with NaN.
    """
    backend = rig.source
    span = backend.upper - backend.lower
    unit = ((start - backend.lower) / span).detach().clone()  # fractions of the ranges: one rate fits all
    mean, square = torch.zeros_like(unit), torch.zeros_like(unit)  # torch.optim would import its compiler, for two seconds
    best, least = start.clone(), torch.full_like(start[:, 0], torch.inf)
    with torch.no_grad():
        for step in range(steps + 1):
            controls = backend.lower + span * unit
            found, vjp = rig.coordinates_and_vjp(controls)
            errors, gradient, _ = distance(found - coordinates)
            better = errors < least
            best = torch.where(better[:, None], controls, best)
            least = torch.where(better, errors, least)
            if step == steps:
                break
            slope = (2 / rig.space.vertex_count * span * vjp(gradient)).nan_to_num_()
            mean.lerp_(slope, 1 - MEMORY)
            square.mul_(SQUARE_MEMORY).addcmul_(slope, slope, value=1 - SQUARE_MEMORY)
            scale = (square / (1 - SQUARE_MEMORY ** (step + 1))).sqrt_().add_(SMALLEST)
            rate = lr * (1 + math.cos(math.pi * step / steps)) / 2 if anneal else lr
            unit.addcdiv_(mean, scale, value=-rate / (1 - MEMORY ** (step + 1))).clamp_(0, 1)
    return best.clamp(backend.lower, backend.upper)
