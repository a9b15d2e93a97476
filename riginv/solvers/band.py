"""Block-banded systems: a matrix for every frame, and the curvature of curves, which ties each frame to four neighbours."""

from collections.abc import Sequence

import torch
from torch import Tensor

TO_NEXT, TO_SECOND = -4.0, 1.0  # the second difference's square couples frames so, away from the ends of a clip
LONGEST_GAP = 12.0  # times the usual distance of frames, across which curves are still smooth; beyond it they begin anew


def usual_steps(numbers: Tensor) -> Tensor:
    """The distances `(frame - 1,)` of frames `(frame,)`, as multiples of the usual one: 1 where none is missing."""
    steps = numbers.diff().double()
    return steps / steps.median() if len(steps) else steps


def spans(numbers: Tensor) -> list[slice]:
    """The rows of frames `(frame,)` between which no gap is too long for curves to be smooth across."""
    cuts = ((usual_steps(numbers) > LONGEST_GAP).nonzero()[:, 0] + 1).tolist()
    return [slice(first, stop) for first, stop in zip([0, *cuts], [*cuts, len(numbers)])]


def second_differences(steps: Tensor) -> Tensor:
    """What the second difference of each three frames in a row is made of, `(frame - 2, 3)`.

    1, -2, 1 where no frame is missing. Else the second derivative of the parabola through the three, times the root of the time
    that it stands for, so that the sum of squares is again the integral of its square; 0 across gaps that are too long.

    Args:
        steps: `(frame - 1,)`, as of `usual_steps`.
    """
    before, after = steps[:-1], steps[1:]
    size = (2 / (before + after)).sqrt() * (torch.maximum(before, after) <= LONGEST_GAP)
    return size[:, None] * torch.stack([1 / before, -1 / before - 1 / after, 1 / after], dim=1)


def second_difference_bands(count: int, before: int = 0, differences: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """The matrix D^T D of second differences over `before + count` frames, of which the first `before` are given.

    Args:
        before: 0 to 2 frames, known already, that lie before the first one asked for.
        differences: as of `second_differences`; None: no frame is missing.

    Returns:
        Its diagonals `(count,)` among the frames asked for: the main one, that to the next frame, that to the second next.
        The last entry of the second and the last two of the third are 0.
    """
    total = before + count
    difference = torch.zeros(max(total - 2, 0), total, dtype=torch.float64)
    if differences is None:
        differences = second_differences(torch.ones(max(total - 1, 0), dtype=torch.float64))
    for row, weights in enumerate(differences):
        difference[row, row : row + 3] = weights
    square = (difference.T @ difference)[before:, before:]
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
