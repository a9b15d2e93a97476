"""Block-banded systems of a clip: a matrix for each frame, coupled to its neighbours by second differences."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Shaped
from torch import Tensor

from riginv.geometry.kernels.library import Kernels, kernels_for

LONGEST_GAP = 12.0  # of frames, as a multiple of the usual step: curves are not smoothed across longer ones


def usual_steps(numbers: Shaped[Tensor, " frame"]) -> Float[Tensor, " step"]:
    """The steps `(frame - 1,)` between frame numbers `(frame,)`, as multiples of their median: 1 where no frame is missing."""
    steps = numbers.diff().double()
    return steps / steps.median() if len(steps) else steps


def spans(numbers: Shaped[Tensor, " frame"]) -> list[slice]:
    """The row ranges of frame numbers `(frame,)` that contain no gap longer than `LONGEST_GAP`."""
    cuts = ((usual_steps(numbers) > LONGEST_GAP).nonzero()[:, 0] + 1).tolist()
    return [slice(first, stop) for first, stop in zip([0, *cuts], [*cuts, len(numbers)])]


def second_differences(steps: Float[Tensor, " step"]) -> Float[Tensor, "difference 3"]:
    """The weights `(frame - 2, 3)` of three consecutive frames in their second difference.

    1, -2, 1 where no frame is missing. Else the second derivative of the parabola through the three, times the square root of
    the time between them, so that the sum of squares is the integral of its square; 0 across gaps that are too long.

    Args:
        steps: from `usual_steps`.
    """
    before, after = steps[:-1], steps[1:]
    size = (2 / (before + after)).sqrt() * (torch.maximum(before, after) <= LONGEST_GAP)
    return size[:, None] * torch.stack([1 / before, -1 / before - 1 / after, 1 / after], dim=1)


def second_difference_bands(
    count: int, before: int = 0, differences: Float[Tensor, "difference 3"] | None = None
) -> tuple[Float[Tensor, " frame"], Float[Tensor, " frame"], Float[Tensor, " frame"]]:
    """The matrix D^T D of second differences over `before + count` frames, of which the first `before` are given.

    Args:
        before: 0 to 2 given frames before the first unknown one.
        differences: from `second_differences`; None: no frame is missing.

    Returns:
        Its diagonals `(count,)` among the unknown frames: the main one, that to the next frame, that to the second next. The
        last entry of the second and the last two of the third are 0.
    """
    total = before + count
    difference = torch.zeros(max(total - 2, 0), total, dtype=torch.float64)
    if differences is None:
        differences = second_differences(torch.ones(max(total - 1, 0), dtype=torch.float64))
    for row, weights in enumerate(differences):
        difference[row, row : row + 3] = weights
    square = (difference.T @ difference)[before:, before:]
    diagonals = [square.diagonal(offset) if offset < count else square.new_zeros(0) for offset in range(3)]
    main, to_next, to_second = (torch.nn.functional.pad(diagonal, (0, count - len(diagonal))) for diagonal in diagonals)
    return main, to_next, to_second


def solve_band(
    blocks: Sequence[Tensor] | Tensor,
    next_to: Float[Tensor, "frame control"],
    second_to: Float[Tensor, "frame control"],
    right: Float[Tensor, "frame control"],
) -> Float[Tensor, "frame control"] | None:
    """Solve a symmetric positive definite system by block Cholesky.

    Args:
        blocks: `(frame, control, control)`, the diagonal blocks.
        next_to, second_to: the diagonals of the blocks that couple a frame to the next and the second
            next; entries that reach beyond the last frame are 0.

    Returns:
        `(frame, control)`, or None where the matrix is not positive definite in its own precision.
    """
    frames, controls = right.shape
    factors, halves, forward = [], [], []
    zero = right.new_zeros(controls, controls)
    correction, after_that, to_next = zero, zero, zero  # Schur complements of earlier frames: this block, the next, between
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
    unknowns = right.new_zeros(frames + 2, controls)
    for frame in reversed(range(frames)):
        rest = forward[frame] - halves[frame][:, :-1] @ unknowns[frame + 1 : frame + 3].flatten()
        unknowns[frame] = torch.linalg.solve_triangular(factors[frame].T, rest[:, None], upper=True)[:, 0]
    return unknowns[:frames]


RunTasks = Callable[[list[Callable[[], int]]], list[int]]  # runs tasks, perhaps in parallel, and returns their results


def run_in_order(tasks: list[Callable[[], int]]) -> list[int]:
    """Run tasks one after the other."""
    return [task() for task in tasks]


class Band(NamedTuple):
    """A block-banded system in which some unknowns are fixed at 0; all in float64.

    Attributes:
        blocks: `(frame, control, control)`, the diagonal blocks.
        diagonal: `(frame, control)`, added to their diagonals.
        near, far: `(frame,)`: the coupling of each control with itself in the next frame and in the second next.
        right: `(frame, control)`.
        free: `(frame, control)`, which unknowns are not fixed.
    """

    blocks: Tensor
    diagonal: Tensor
    near: Tensor
    far: Tensor
    right: Tensor
    free: Tensor

    def solve(self, run_tasks: RunTasks) -> Float[Tensor, "frame control"] | None:
        """The unknowns `(frame, control)`, or None where the matrix of the free ones is not positive definite.

        Frames are eliminated from both ends towards the middle.

        Args:
            run_tasks: runs two tasks, perhaps in parallel.
        """
        compiled = kernels_for(self.blocks, self.diagonal, self.right)
        return self._solve_in_torch() if compiled is None else _TwoChains(self, compiled).solve(run_tasks)

    def _solve_in_torch(self) -> Tensor | None:
        both = self.free[:, :, None] & self.free[:, None]
        reduced = torch.where(both, self.blocks + torch.diag_embed(self.diagonal), 0.0)
        reduced.diagonal(dim1=1, dim2=2).add_(~self.free)
        to_next = self.near[:, None] * (self.free & torch.roll(self.free, -1, 0))
        to_second = self.far[:, None] * (self.free & torch.roll(self.free, -2, 0))
        found = solve_band(reduced, to_next, to_second, torch.where(self.free, self.right, 0.0))
        return None if found is None else torch.where(self.free, found, 0.0)


class _TwoChains:
    """Elimination of the frames before the middle two and of those after them, each as a chain, by kernels."""

    def __init__(self, band: Band, compiled: Kernels) -> None:
        self.compiled, (frames, self.controls) = compiled, band.right.shape
        sizes = band.free.sum(dim=1)
        self.starts = torch.cat([sizes.new_zeros(1), sizes.cumsum(0)])
        self.numbers = band.free.nonzero()[:, 1].contiguous()
        tensors = (band.blocks, band.diagonal, band.near, band.far, band.right, self.starts, self.numbers)
        self.system: tuple[Tensor | int, ...] = (*(values.contiguous() for values in tensors), self.controls)
        self.right = band.right
        self.middle = max(frames - 2, 0) // 2, (max(frames - 2, 0) // 2 + 1 if frames > 1 else -1)
        first, second = self.middle
        before, after = list(range(first)), list(range(frames - 1, max(first, second), -1))
        self.chains = [torch.tensor([*before, first, second]), torch.tensor([*after, second, first])]
        self.stores = [self._store(chain, [*sizes.tolist(), 0]) for chain in self.chains]
        self.corrections = [band.right.new_zeros(3, self.controls, self.controls) for _ in self.chains]
        self.pulled = [band.right.new_zeros(2, self.controls) for _ in self.chains]

    def solve(self, run_tasks: RunTasks) -> Tensor | None:
        if any(run_tasks([lambda: self._eliminate(0), lambda: self._eliminate(1)])):
            return None
        found = torch.zeros_like(self.right, memory_format=torch.contiguous_format)
        taken = (self.corrections[0], self.pulled[0], self.corrections[1], self.pulled[1])
        if self.compiled.call("band_middle", torch.float64, *self.system, *self.middle, *taken, found):
            return None
        run_tasks([lambda: self._substitute(0, found), lambda: self._substitute(1, found)])
        return found

    def _eliminate(self, number: int) -> int:
        chain, (store, offsets) = self.chains[number], self.stores[number]
        given = (*self.system, chain, len(chain) - 2, store, offsets, self.corrections[number], self.pulled[number])
        return self.compiled.call("band_eliminate", torch.float64, *given)

    def _substitute(self, number: int, found: Tensor) -> int:
        chain, (store, offsets) = self.chains[number], self.stores[number]
        given = (self.starts, self.numbers, self.controls, chain, len(chain) - 2, store, offsets, found)
        return self.compiled.call("band_substitute", torch.float64, *given)

    def _store(self, chain: Tensor, sizes: list[int]) -> tuple[Tensor, Tensor]:
        """Memory for the factors of a chain, and the offset of each frame's: L, its inverse diagonal, its couplings."""
        offsets, total = [], 0
        for frame, near, far in zip(*(chain[shift : len(chain) - 2 + shift].tolist() for shift in range(3))):
            offsets.append(total)
            size, stride = sizes[frame], -(-sizes[frame] // 8) * 8
            total += -(-size // 4) * 4 * stride + stride + size * (-(-(sizes[near] + sizes[far] + 1) // 8) * 8)
        return torch.empty(total, dtype=torch.float64), torch.tensor(offsets, dtype=torch.int64)
