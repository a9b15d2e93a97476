"""Linear least squares for weights that stay in [0, 1]."""

import torch
from torch import Tensor

from riginv.solvers.box_step import box_step

ROUNDS = 100  # at most; most meshes settle after a few
SETTLED = 1e-9  # no weight moves by more


def bounded_least_squares(gram: Tensor, right: Tensor) -> Tensor:
    """Weights `(mesh, shape)` in [0, 1] that minimise half w^T G w - b^T w, for all meshes at once.

    Which weights end at a limit is guessed and solved for, and where that does not descend it is left; a sweep over the
    weights one by one, which always descends, comes after it.

    Args:
        gram: G `(shape, shape)`, positive definite.
        right: b `(mesh, shape)`.
    """
    found = torch.zeros_like(right)
    moving = torch.arange(len(right), device=right.device)
    for _ in range(ROUNDS):
        before = found[moving]
        gradient = before @ gram - right[moving]
        step = box_step(gram.expand(len(moving), -1, -1), gradient, before)
        change = (gradient * step).sum(dim=1) + 0.5 * (step * (step @ gram)).sum(dim=1)
        at = torch.where((change < 0)[:, None], (before + step).clamp(0, 1), before)
        found[moving] = _sweep(gram, right[moving], at)
        moving = moving[((found[moving] - before).abs() > SETTLED).any(dim=1)]
        if not len(moving):
            break
    return found


def _sweep(gram: Tensor, right: Tensor, at: Tensor) -> Tensor:
    at = at.clone()
    for shape, size in enumerate(gram.diagonal().tolist()):
        at[:, shape] += (right[:, shape] - at @ gram[shape]) / size
        at[:, shape].clamp_(0, 1)
    return at
