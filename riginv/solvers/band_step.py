"""One step of a block-banded quadratic model that stays in a box: the frames of a clip, tied by second differences."""

import torch
from torch import Tensor

from riginv.solvers.band import AtOnce, Band, in_turn

ROUNDS = 2  # of solving and pinning what leaves the box


def band_box_step(
    blocks: Tensor, added: Tensor, near: Tensor, far: Tensor, gradient: Tensor, at: Tensor, at_once: AtOnce = in_turn
) -> Tensor:
    """As `box_step`, for all frames together.

    Args:
        blocks: the diagonal blocks `(frame, control, control)`, float64.
        added: what is added to their diagonals, `(frame, control)`, float64.
        near, far: what couples each frame to the next and to the second next, `(frame,)`; 0 beyond the last frame.
        gradient: `(frame, control)`, float64.
        at: where the controls stand, `(frame, control)` in [0, 1].
        at_once: runs tasks, perhaps at the same time.

    Returns:
        The step `(frame, control)`; none where the matrix is not positive definite.
    """
    free = ~(((at <= 0) & (gradient > 0)) | ((at >= 1) & (gradient < 0)))
    step = torch.zeros_like(at)
    for _ in range(ROUNDS):
        pinned = torch.where(free, 0.0, step).double()
        rest = gradient + (blocks @ pinned[..., None])[..., 0] + added * pinned
        rest[1:] += near[:-1, None] * pinned[:-1]
        rest[:-1] += near[:-1, None] * pinned[1:]
        rest[2:] += far[:-2, None] * pinned[:-2]
        rest[:-2] += far[:-2, None] * pinned[2:]
        solved = Band(blocks, added, near, far, -rest, free).solve(at_once)
        if solved is None:
            return torch.zeros_like(at)
        target = at + torch.where(free, solved, pinned).to(at)
        step = target.clamp(0, 1) - at
        leaving = free & ((target < 0) | (target > 1))
        if not bool(leaving.any()):
            break
        free = free & ~leaving
    return step
