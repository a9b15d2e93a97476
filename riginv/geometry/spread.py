"""A few of many, spread as evenly as they lie: rows of a set, or points in space."""

import torch
from torch import Tensor


def evenly(count: int, of: int) -> Tensor:
    """`count` rows `(row,)` of `of`, in order, from the first to the last; all of them where there are no more."""
    return torch.linspace(0, of - 1, min(count, of), dtype=torch.float64).round().long()


def spread_points(points: Tensor, count: int) -> Tensor:
    """Indices `(count,)` of points `(point, dimension)`: the one nearest to their mean, then each the farthest from all before.

    All of them where there are no more than `count`.
    """
    chosen = [int((points - points.mean(dim=0)).norm(dim=1).argmin())]
    distance = (points - points[chosen[0]]).norm(dim=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (points - points[chosen[-1]]).norm(dim=1))
    return torch.tensor(chosen, device=points.device)
