"""Block-banded systems: a matrix for every frame, and the curvature of curves, which ties each frame to four neighbours."""

from collections.abc import Sequence

import torch
from torch import Tensor

TO_NEXT, TO_SECOND = -4.0, 1.0  # the second difference's square couples frames so, away from the ends of a clip


def second_difference_bands(count: int, before: int = 0, weights: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """The matrix D^T W D of second differences over `before + count` frames, of which the first `before` are given.

    Args:
        before: 0 to 2 frames, known already, that lie before the first one asked for.
        weights: of each second difference, `(before + count - 2,)`; None: 1.

    Returns:
        Its diagonals `(count,)` among the frames asked for: the main one, that to the next frame, that to the second next.
        The last entry of the second and the last two of the third are 0.
    """
    total = before + count
    difference = torch.zeros(max(total - 2, 0), total, dtype=torch.float64)
    for row in range(len(difference)):
        difference[row, row : row + 3] = torch.tensor([1.0, -2.0, 1.0], dtype=torch.float64)
    weighted = difference if weights is None else weights.to(difference)[:, None] * difference
    square = (difference.T @ weighted)[before:, before:]
    diagonals = [square.diagonal(offset) if offset < count else square.new_zeros(0) for offset in range(3)]
    return tuple(torch.nn.functional.pad(diagonal, (0, count - len(diagonal))) for diagonal in diagonals)


def solve_band(blocks: Sequence[Tensor] | Tensor, next_to: Tensor, second_to: Tensor, right: Tensor) -> Tensor | None:
    """Solve a symmetric positive definite system by block Cholesky.

    Args:
        blocks: `(frame, control, control)`, the diagonal blocks.
        next_to, second_to: `(frame, control)`, the diagonals of the blocks that couple a frame to the next and the second
            next; entries that reach beyond the last frame are 0.
        right: `(frame, control)`.

    Returns:
        `(frame, control)`, or None where the matrix is not positive definite in its own precision.
    """
    frames, controls = right.shape
    factors, halves, forward = [], [], []
    zero = right.new_zeros(controls, controls)
    correction, after_that, to_next = zero, zero, zero  # what earlier frames take from this block, the next, and between
    pulled, pulled_next = right.new_zeros(controls), right.new_zeros(controls)
    for frame in range(frames):
        factor, failed = torch.linalg.cholesky_ex(blocks[frame] - correction)
        if failed:
            return None
        coupling = torch.cat(
            [
                torch.diag(next_to[frame]) - to_next,
                torch.diag(second_to[frame]),
                (right[frame] - pulled)[:, None],
            ],
            dim=1,
        )
        half = torch.linalg.solve_triangular(factor, coupling, upper=False)
        near, far, value = half[:, :controls], half[:, controls:-1], half[:, -1]
        correction, after_that = after_that + near.T @ near, far.T @ far
        to_next = near.T @ far
        pulled, pulled_next = pulled_next + near.T @ value, far.T @ value
        factors.append(factor)
        halves.append(half)
        forward.append(value)
    found = right.new_zeros(frames + 2, controls)
    for frame in reversed(range(frames)):
        rest = forward[frame] - halves[frame][:, :-1] @ found[frame + 1 : frame + 3].flatten()
        found[frame] = torch.linalg.solve_triangular(factors[frame].T, rest[:, None], upper=True)[:, 0]
    return found[:frames]
