"""A step of a block-banded quadratic model within a box: the frames of a clip, coupled by second differences."""

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.solvers.band import Band, RunTasks, run_in_order

ROUNDS = 2  # of solving, and fixing controls that leave the box


def band_box_step(
    blocks: Float[Tensor, "frame control control"],
    added: Float[Tensor, "frame control"],
    near: Float[Tensor, " frame"],
    far: Float[Tensor, " frame"],
    gradient: Float[Tensor, "frame control"],
    at: Float[Tensor, "frame control"],
    run_tasks: RunTasks = run_in_order,
) -> Float[Tensor, "frame control"]:
    """As `box_step`, for all frames of a clip together.

    Args:
        blocks: the diagonal blocks, float64.
        added: added to their diagonals, float64.
        near, far: the coupling of each frame to the next and to the second next; 0 beyond the last frame.
        gradient: float64.
        at: the current controls in [0, 1].
        run_tasks: runs tasks, perhaps in parallel.

    Returns:
        The step `(frame, control)`; 0 where the matrix is not positive definite.
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
        solved = Band(blocks, added, near, far, -rest, free).solve(run_tasks)
        if solved is None:
            return torch.zeros_like(at)
        target = at + torch.where(free, solved, pinned).to(at)
        step = target.clamp(0, 1) - at
        leaving = free & ((target < 0) | (target > 1))
        if not bool(leaving.any()):
            break
        free = free & ~leaving
    return step
