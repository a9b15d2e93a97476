"""Linear least squares for weights that stay in [0, 1]."""

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.solvers.box_step import box_step

ROUNDS = 100  # at most; most meshes converge after a few
TOLERANCE = 1e-9  # a mesh has converged once no weight changes by more


def bounded_least_squares(
    gram: Float[Tensor, "shape shape"], right: Float[Tensor, "mesh shape"]
) -> Float[Tensor, "mesh shape"]:
    """Weights `(mesh, shape)` in [0, 1] that minimise half w^T G w - b^T w, for all meshes at once.

    Each round takes a step of `box_step`, where that descends, and then one of coordinate descent, which always does.

    Args:
        gram: G, positive definite.
        right: b.
    """
    found = torch.zeros_like(right)
    active = torch.arange(len(right), device=right.device)
    for _ in range(ROUNDS):
        before = found[active]
        gradient = before @ gram - right[active]
        step = box_step(gram.expand(len(active), -1, -1), gradient, before)
        change = (gradient * step).sum(dim=1) + 0.5 * (step * (step @ gram)).sum(dim=1)
        at = torch.where((change < 0)[:, None], (before + step).clamp(0, 1), before)
        found[active] = _sweep(gram, right[active], at)
        active = active[((found[active] - before).abs() > TOLERANCE).any(dim=1)]
        if not len(active):
            break
    return found


def _sweep(gram: Tensor, right: Tensor, at: Tensor) -> Tensor:
    """One round of coordinate descent."""
    at = at.clone()
    for shape, size in enumerate(gram.diagonal().tolist()):
        at[:, shape] += (right[:, shape] - at @ gram[shape]) / size
        at[:, shape].clamp_(0, 1)
    return at
