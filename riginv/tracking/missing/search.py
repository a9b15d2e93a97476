"""Which drivers call for a shape, and the shapes: orthogonal matching pursuit in which each vertex votes for its driver."""

import torch
from jaxtyping import Float
from torch import Tensor

VERTICES = 400  # that vote
NEAR_BEST = 0.97  # of the gain of a vertex's best driver: such drivers have its vote
MIN_NEW = 0.02  # of a driver's energy that must lie outside of those found so far
MIN_GAIN = 0.002  # of the squared residual that a further shape must explain
RIDGE = 1e-6  # of the largest driver
SPARSE, SPARSE_MM = 0.02, 0.02  # displacements below this fraction of a shape's largest, or below so many mm, are left out


def choose_drivers(
    signals: Float[Tensor, "frame driver"],
    likelihoods: Float[Tensor, "driver vertex"],
    residual: Float[Tensor, "frame vertex 3"],
    most: int,
) -> list[int]:
    """The drivers, at most `most`, that together explain a residual, best first.

    Vertices vote, each for the driver that explains it best, so that shapes stay local: the left side of a face has its own
    driver where left and right nearly move together.

    Args:
        likelihoods: factors on the gains: how likely a driver is to call for a shape at a vertex.
        residual: mm.
    """
    energy = residual.square().sum(dim=(0, 2))
    moving = (energy > 1e-3 * energy.amax()).nonzero()[:, 0]
    voters = moving[:: max(1, len(moving) // VERTICES)]
    target, likelihoods = residual[:, voters], likelihoods[:, voters]
    shape, target = target.shape[1:], target.flatten(1).clone()
    total, signals = target.square().sum(), signals.clone()
    before = signals.square().sum(dim=0)
    chosen: list[int] = []
    while len(chosen) < most and len(signals.T):
        size = signals.square().sum(dim=0)
        usable = size > MIN_NEW * before
        gains = (signals.T @ target).unflatten(1, shape).square().sum(dim=2) / size.clamp_min(1e-9)[:, None]
        gains = torch.where(usable[:, None], gains, 0.0)
        weighted = gains * likelihoods
        votes = torch.where(weighted >= NEAR_BEST * weighted.amax(dim=0), weighted, 0.0).sum(dim=1)
        best = int(votes.argmax())
        if float(gains[best].sum()) < MIN_GAIN * float(total):
            break
        chosen.append(best)
        direction = signals[:, best] / size[best].sqrt()
        target -= direction[:, None] * (direction @ target)
        signals -= direction[:, None] * (direction @ signals)
    return chosen


def fit_shapes(
    signals: Float[Tensor, "frame driver"], residual: Float[Tensor, "frame vertex 3"]
) -> Float[Tensor, "driver vertex 3"]:
    """The sparse shapes, mm, with which the chosen drivers explain a residual best, by least squares."""
    gram = signals.T.double() @ signals.double()
    gram.diagonal().add_(RIDGE * gram.diagonal().amax())
    right = (signals.T @ residual.flatten(1)).double()
    shapes = torch.linalg.solve(gram, right).to(residual.dtype).unflatten(1, residual.shape[1:])
    length = shapes.norm(dim=2)
    least = (SPARSE * length.amax(dim=1, keepdim=True)).clamp_min(SPARSE_MM)
    return torch.where((length > least)[..., None], shapes, 0.0)
