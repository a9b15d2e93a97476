"""A step of a block-banded quadratic model within a box: the frames of a clip, coupled by second differences."""

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.solvers.band import Band, RunTasks, run_in_order

ROUNDS = 2  # of solving, and fixing controls that leave the box
PINNED = 1e6  # times a frame's greatest curvature: holds fixed controls where the unknowns are combinations of controls


def band_box_step(
    blocks: Float[Tensor, "frame control control"],
    added: Float[Tensor, "frame control"],
    near: Float[Tensor, " frame"],
    far: Float[Tensor, " frame"],
    gradient: Float[Tensor, "frame control"],
    at: Float[Tensor, "frame control"],
    run_tasks: RunTasks = run_in_order,
    main: Float[Tensor, " frame"] | None = None,
    root: Float[Tensor, "control control"] | None = None,
) -> Float[Tensor, "frame control"]:
    """As `box_step`, for all frames of a clip together.

    Args:
        blocks: the diagonal blocks, float64.
        added: added to their diagonals, float64.
        near, far: the coupling of each frame to the next and to the second next; 0 beyond the last frame.
        gradient: float64.
        at: the current controls in [0, 1].
        run_tasks: runs tasks, perhaps in parallel.
        main: the coupling of each frame with itself; None: `added` has it.
        root: the couplings are those of x in step = root x, float64; None: of the controls.

    Returns:
        The step `(frame, control)`; 0 where the matrix is not positive definite.
    """
    free = ~(((at <= 0) & (gradient > 0)) | ((at >= 1) & (gradient < 0)))
    step = torch.zeros_like(at)
    added = added if main is None or root is not None else added + main[:, None]
    for _ in range(ROUNDS):
        pinned = torch.where(free, 0.0, step).double()
        if root is None:
            solved = _separate(blocks, added, near, far, gradient, free, pinned, run_tasks)
        else:
            assert main is not None
            solved = _combined(blocks, added, (main, near, far), gradient, free, pinned, root, run_tasks)
        if solved is None:
            return torch.zeros_like(at)
        target = at + torch.where(free, solved, pinned).to(at)
        step = target.clamp(0, 1) - at
        leaving = free & ((target < 0) | (target > 1))
        if not bool(leaving.any()):
            break
        free = free & ~leaving
    return step


def _separate(
    blocks: Tensor,
    added: Tensor,
    near: Tensor,
    far: Tensor,
    gradient: Tensor,
    free: Tensor,
    pinned: Tensor,
    run_tasks: RunTasks,
) -> Tensor | None:
    """The step of the free controls, each coupled with itself in other frames."""
    rest = gradient + (blocks @ pinned[..., None])[..., 0] + added * pinned
    rest[1:] += near[:-1, None] * pinned[:-1]
    rest[:-1] += near[:-1, None] * pinned[1:]
    rest[2:] += far[:-2, None] * pinned[:-2]
    rest[:-2] += far[:-2, None] * pinned[2:]
    return Band(blocks, added, near, far, -rest, free).solve(run_tasks)


def _combined(
    blocks: Tensor,
    added: Tensor,
    couplings: tuple[Tensor, Tensor, Tensor],
    gradient: Tensor,
    free: Tensor,
    pinned: Tensor,
    root: Tensor,
    run_tasks: RunTasks,
) -> Tensor | None:
    """The step in combinations of controls, which couplings take to be independent."""
    main, near, far = couplings
    strong = PINNED * (blocks.diagonal(dim1=1, dim2=2).amax(dim=1, keepdim=True) + main[:, None])
    diagonal = added + torch.where(free, 0.0, strong)
    right = torch.where(free, -gradient, strong * pinned) @ root
    whole = root.T @ (blocks + torch.diag_embed(diagonal)) @ root
    solved = Band(whole, main[:, None].expand_as(right), near, far, right, torch.ones_like(free)).solve(run_tasks)
    return None if solved is None else solved @ root.T
