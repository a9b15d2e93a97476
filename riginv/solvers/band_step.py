"""One step of a block-banded quadratic model that stays in a box: the frames of a clip, tied by second differences."""

import torch
from torch import Tensor

from riginv.solvers.band import solve_band

ROUNDS = 2  # of solving and pinning what leaves the box


def band_box_step(blocks: Tensor, near: Tensor, far: Tensor, gradient: Tensor, at: Tensor, rounds: int = ROUNDS) -> Tensor:
    """As `box_step`, for all frames together.

    Args:
        blocks: the diagonal blocks `(frame, control, control)`, float64, damped.
        near, far: what couples each frame to the next and to the second next, `(frame,)`; 0 beyond the last frame.
        gradient: `(frame, control)`, float64.
        at: where the controls stand, `(frame, control)` in [0, 1].

    Returns:
        The step `(frame, control)`; none where the matrix is not positive definite.
    """
    free = ~(((at <= 0) & (gradient > 0)) | ((at >= 1) & (gradient < 0)))
    step = torch.zeros_like(at)
    for _ in range(rounds):
        pinned = torch.where(free, 0.0, step).double()
        rest = gradient + (blocks @ pinned[..., None])[..., 0]
        rest[1:] += near[:-1, None] * pinned[:-1]
        rest[:-1] += near[:-1, None] * pinned[1:]
        rest[2:] += far[:-2, None] * pinned[:-2]
        rest[:-2] += far[:-2, None] * pinned[2:]
        both = free[:, :, None] & free[:, None]
        reduced = torch.where(both, blocks, 0.0)
        reduced.diagonal(dim1=1, dim2=2).add_(~free)
        to_next = near[:, None] * (free & torch.roll(free, -1, 0))
        to_second = far[:, None] * (free & torch.roll(free, -2, 0))
        solved = solve_band(reduced, to_next, to_second, torch.where(free, -rest, 0.0))
        if solved is None:
            return torch.zeros_like(at)
        target = at + torch.where(free, solved, pinned).to(at)
        step = target.clamp(0, 1) - at
        leaving = free & ((target < 0) | (target > 1))
        if not bool(leaving.any()):
            break
        free = free & ~leaving
    return step
