"""Drivers and shapes where the controls are known: what the clip lacks is then a sum of drivers times shapes.

So each driver of a missing shape lies in the span of the residual's coordinates over the frames (as in the MUSIC method of
direction finding), which few of the candidates do; among these vertices vote. Of drivers that move alike in the clip only the
sum of their shapes is determined: it is split among those whose controls move its vertices.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from riginv.tracking.missing.drivers import Driver, Factors
from riginv.tracking.missing.search import MIN_GAIN_KNOWN, Limits, choose_drivers, fit_shapes, sparse, voters

ABOVE = 3.0  # times the median squared size of the residual's directions, which is noise: the span's directions have more
FARTHER, LEAST_DISTANCE = 10.0, 1e-6  # squared distances from the span, of the driver that would just fill it: those looked at
MOST_LOOKED_AT = 1000  # drivers, nearest first
MIN_NEW, MOST_NEW = 1e-4, 5e-3  # of a driver's energy that must lie outside of those found, in an exact span and in noise
ALIKE, ALIKE_IN_NOISE = 1e-3, 1e-5  # of a driver's energy, what does not move as another does: shapes are told apart by place
MIN_PART = 0.1  # of what remains: a driver that explains as much is chosen below the least gain, too
SIGNIFICANT = 3.0  # times what a driver that has nothing to do with white noise explains of it
LEAST_SHARE = 0.125  # of the squared displacement of a sum of shapes: drivers with less have no part in it


def find_known(
    factors: Factors,
    drivers: list[Driver],
    signals: Float[Tensor, "frame driver"],
    residual: Float[Tensor, "frame vertex 3"],
    most: int,
) -> tuple[list[Driver], Float[Tensor, "driver vertex 3"]]:
    """The drivers, at most `most`, of a residual, mm, and their sparse shapes."""
    signals, target = signals.double(), residual.flatten(1).double()
    voting = voters(residual)
    least = MIN_GAIN_KNOWN * float(target.unflatten(1, residual.shape[1:])[:, voting].square().sum())
    chosen: list[int] = []
    shapes = target[:0]
    while len(chosen) < most:
        span = torch.linalg.qr(signals[:, chosen])[0]
        outside = target - span @ (span.T @ target)
        near, distances = nearest(signals, span, outside, most - len(chosen))
        likelihoods = factors.likelihoods([drivers[number] for number in near.tolist()], voting).double()
        new = signals[:, near] - span @ (span.T @ signals[:, near])
        some = outside.unflatten(1, residual.shape[1:])[:, voting]
        limits = Limits(least, MIN_PART, min(max(float(distances[-1]), MIN_NEW), MOST_NEW), SIGNIFICANT)
        found = near[choose_drivers(new, likelihoods, some, most - len(chosen), limits)].tolist()
        if not found:
            break
        more = fit_shapes(signals[:, found] - span @ (span.T @ signals[:, found]), outside)
        found, more = split(factors, drivers, signals, near, distances, found, more)
        chosen, shapes = [*chosen, *found], torch.cat([shapes, more])
        shapes = shapes + fit_shapes(signals[:, chosen], target - signals[:, chosen] @ shapes)
    strongest = (signals[:, chosen].norm(dim=0) * shapes.norm(dim=1)).argsort(descending=True)[:most].sort().values
    chosen, shapes = [chosen[number] for number in strongest.tolist()], shapes[strongest]
    shapes = shapes + fit_shapes(signals[:, chosen], target - signals[:, chosen] @ shapes)
    return [drivers[number] for number in chosen], sparse(shapes.unflatten(1, residual.shape[1:]).to(residual))


def nearest(
    signals: Float[Tensor, "frame driver"],
    span: Float[Tensor, "frame chosen"],
    outside: Float[Tensor, "frame coordinate"],
    most: int,
) -> tuple[Int[Tensor, " near"], Float[Tensor, " near"]]:
    """The drivers whose part outside of a span lies nearest to the directions of what remains there, and how near, squared."""
    squares, directions = torch.linalg.eigh(outside @ outside.T)
    kept = (squares > ABOVE * squares.median()).nonzero()[-most:, 0]
    size = signals.square().sum(dim=0)
    left = size - (span.T @ signals).square().sum(dim=0)
    distances = 1 - (directions[:, kept].T @ signals).square().sum(dim=0) / left.clamp_min(1e-12)
    distances[left < MIN_NEW * size] = torch.inf
    order = distances.argsort()[:MOST_LOOKED_AT]
    farthest = FARTHER * float(distances[order[min(len(kept), len(order)) - 1]])
    order = order[distances[order] <= max(farthest, LEAST_DISTANCE)]
    return order, distances[order]


def split(
    factors: Factors, drivers: list[Driver], signals: Tensor, near: Tensor, distances: Tensor, chosen: list[int], shapes: Tensor
) -> tuple[list[int], Tensor]:
    """The chosen drivers and those that move like one of them, and the shape of each by its controls' displacements."""
    sizes = signals.norm(dim=0)
    unlike = ALIKE if float(distances[-1]) <= LEAST_DISTANCE else ALIKE_IN_NOISE
    found: list[int] = []
    parts: list[Tensor] = []
    for number, shape in zip(chosen, shapes):
        cosines = signals[:, near].T @ signals[:, number] / (sizes[near] * sizes[number])
        farthest = 2 * distances[near == number] + LEAST_DISTANCE
        alike = near[(1 - cosines.square() < unlike) & (distances <= farthest)].tolist()
        alike = [one for one in alike if one == number or one not in chosen]
        alike = [one for one in alike if not any(factors.is_simpler(drivers[other], drivers[one]) for other in alike)]
        energy = shape.unflatten(0, (-1, 3)).square().sum(dim=1)
        while True:
            nearness = torch.stack([factors.nearness(drivers[one]) for one in alike]).double()
            shares = nearness / nearness.sum(dim=0)
            weights = (shares.square() * energy).sum(dim=1) / energy.sum()
            if len(alike) == 1 or weights.min() >= LEAST_SHARE:
                break
            alike.pop(int(weights.argmin()))
        found += alike
        parts += [share.repeat_interleave(3) * shape * sizes[number] / sizes[one] for share, one in zip(shares, alike)]
    return found, torch.stack(parts)
