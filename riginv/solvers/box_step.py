"""One step of a damped quadratic model that stays in a box, for many frames at once."""

import torch
from torch import Tensor

ROUNDS = 3  # of solving and pinning what leaves the box
FLOOR = 1e-3  # of the mean curvature: what damps a control that does nothing


def damped(hessian: Tensor, damping: Tensor) -> Tensor:
    """Hessians `(mesh, control, control)` with Marquardt's damping `(mesh,)`, relative to their diagonals."""
    diagonal = hessian.diagonal(dim1=1, dim2=2)
    floor = FLOOR * diagonal.mean(dim=1, keepdim=True) + torch.finfo(hessian.dtype).tiny
    return hessian + torch.diag_embed(damping[:, None] * (diagonal + floor))


def box_step(matrix: Tensor, gradient: Tensor, at: Tensor) -> Tensor:
    """The step `(mesh, control)` that minimises a quadratic model over the box from 0 to 1, nearly.

    Controls at a limit that the gradient pushes outward stay; the others are solved for, those that would leave the box are
    pinned to the limit that they hit, and the rest is solved again around them, a few times. Where a matrix is not positive
    definite in its own precision it is taken apart in float64; a frame for which that fails too stays where it is.

    Args:
        matrix: `(mesh, control, control)`, damped.
        gradient: `(mesh, control)`.
        at: where the controls stand, `(mesh, control)` in [0, 1].
    """
    free = ~(((at <= 0) & (gradient > 0)) | ((at >= 1) & (gradient < 0)))
    step = torch.zeros_like(at)
    for _ in range(ROUNDS):
        pinned = torch.where(free, 0.0, step)
        rest = torch.where(free, -gradient - (matrix @ pinned[..., None])[..., 0], 0.0)
        target = at + torch.where(free, _solve(matrix, rest, free), pinned)
        step = target.clamp(0, 1) - at
        leaving = free & ((target < 0) | (target > 1))
        if not bool(leaving.any()):
            break
        free = free & ~leaving
    return step


def _solve(matrix: Tensor, right: Tensor, free: Tensor) -> Tensor:
    """Solve for the free controls alone; 0 for the others."""
    both = free[:, :, None] & free[:, None]
    reduced = torch.where(both, matrix, 0.0)
    reduced.diagonal(dim1=1, dim2=2).add_(~free)
    factor, failed = torch.linalg.cholesky_ex(reduced)
    found = torch.cholesky_solve(right[..., None], factor)[..., 0]
    bad = (failed > 0).nonzero()[:, 0]
    if len(bad):
        exact, failed = torch.linalg.cholesky_ex(reduced[bad].double())
        again = torch.cholesky_solve(right[bad, :, None].double(), exact)[..., 0]
        found[bad] = torch.where((failed > 0)[:, None], 0.0, again).to(found)
    return found
