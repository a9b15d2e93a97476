"""Search for missing shapes and their drivers: orthogonal matching pursuit in which each vertex votes for its driver."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

VERTICES = 400  # that vote
NEAR_BEST = 0.97  # of the gain of a vertex's best driver: such drivers have its vote
MIN_NEW = 0.005  # of a driver's energy that must lie outside of those found so far
MIN_GAIN_KNOWN = 1e-4  # of the squared residual that a further shape must explain, with the true controls
MIN_GAINS = (1e-2, 4e-3, 1e-3)  # the same in each round with solved controls: the surest drivers come first
RIDGE = 1e-4  # of a driver of unit length
SPARSE, SPARSE_MM = 0.02, 0.02  # displacements below this fraction of a shape's largest, or below so many mm, are left out


@dataclass(frozen=True)
class Limits:
    """What a further driver must explain, and be.

    Attributes:
        least: of the squared residual, mm^2.
        part: of what remains of it: a driver that explains as much is chosen below `least`, too.
        new: of its energy, what lies outside of those found so far.
        significant: times what a driver that has nothing to do with a residual of white noise explains of it.
    """

    least: float
    part: float = 1.0
    new: float = MIN_NEW
    significant: float = 0.0


def voters(residual: Float[Tensor, "frame vertex 3"]) -> Int[Tensor, " voter"]:
    """The vertices that vote: evenly spread ones of those with a residual, mm."""
    energy = residual.square().sum(dim=(0, 2))
    moving = (energy > 1e-3 * energy.amax()).nonzero()[:, 0]
    return moving[:: max(1, len(moving) // VERTICES)]


def choose_drivers(
    signals: Float[Tensor, "frame driver"],
    likelihoods: Float[Tensor, "driver voter"],
    target: Float[Tensor, "frame voter 3"],
    most: int,
    limits: Limits,
) -> list[int]:
    """The drivers, at most `most`, that together explain a residual, best first.

    Vertices vote, each for the driver that explains it best, so that shapes stay local: the left side of a face has its own
    driver where left and right nearly move together.

    Args:
        likelihoods: factors on the gains: how likely a driver is to call for a shape at a vertex.
        target: the residual, mm, at the vertices that vote.
        limits: what a further driver must explain.
    """
    shape, target = target.shape[1:], target.flatten(1).clone()
    signals = signals.clone()
    before = signals.square().sum(dim=0)
    products = signals.T @ target
    chosen: list[int] = []
    while len(chosen) < most and len(signals.T):
        size = signals.square().sum(dim=0)
        usable = size > limits.new * before
        gains = products.unflatten(1, shape).square().sum(dim=2) / size.clamp_min(1e-9)[:, None]
        gains = torch.where(usable[:, None], gains, 0.0)
        weighted = gains * likelihoods
        votes = torch.where(weighted >= NEAR_BEST * weighted.amax(dim=0), weighted, 0.0).sum(dim=1)
        best = int(votes.argmax())
        gain, remains = float(gains[best].sum()), float(target.square().sum())
        noise = limits.significant * remains / max(1, len(target) - len(chosen))
        if gain <= min(limits.least, limits.part * remains) or gain < noise:
            break
        chosen.append(best)
        direction = signals[:, best] / size[best].sqrt()
        parts, explained = direction @ signals, direction @ target
        products -= parts[:, None] * explained
        target -= direction[:, None] * explained
        signals -= direction[:, None] * parts
    return chosen


def fit_shapes(
    signals: Float[Tensor, "frame driver"], residual: Float[Tensor, "frame coordinate"]
) -> Float[Tensor, "driver coordinate"]:
    """The shapes, mm, with which the chosen drivers explain a residual best: least squares with a small ridge."""
    scale = signals.norm(dim=0).clamp_min(1e-6)
    scaled = signals / scale
    gram = scaled.T @ scaled + RIDGE * torch.eye(len(scale)).to(scaled)
    return torch.linalg.solve(gram, scaled.T @ residual) / scale[:, None]


def sparse(shapes: Float[Tensor, "driver vertex 3"]) -> Float[Tensor, "driver vertex 3"]:
    """Shapes without their small displacements."""
    length = shapes.norm(dim=2)
    least = (SPARSE * length.amax(dim=1, keepdim=True)).clamp_min(SPARSE_MM)
    return torch.where((length > least)[..., None], shapes, 0.0)


def conjugate_gradients(operator: Callable[[Tensor], Tensor], right: Tensor, steps: int = 60) -> Tensor:
    """The solution of a symmetric positive semidefinite system, from 0."""
    solution, residual = torch.zeros_like(right), right.clone()
    direction, size = residual.clone(), residual.square().sum()
    first = size.clone()
    for _ in range(steps):
        if float(size) <= 1e-8 * float(first):
            break
        image = operator(direction)
        step = size / (direction * image).sum().clamp_min(1e-20)
        solution += step * direction
        residual -= step * image
        size, before = residual.square().sum(), size
        direction = residual + size / before * direction
    return solution
