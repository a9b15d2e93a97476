"""A whole clip at once: the least error for curves that are smooth."""

from collections.abc import Iterator

import torch
from torch import Tensor

from riginv.solvers.band import second_difference_bands, second_differences, usual_steps
from riginv.solvers.band_step import band_box_step
from riginv.solvers.box_step import FLOOR
from riginv.solvers.levenberg_marquardt import LEAST_DAMPING, MOST_DAMPING, START_DAMPING
from riginv.solvers.objective import Linearised, Objective

WINDOW, LOOKAHEAD = 192, 48  # frames that are kept of a window, and those solved beyond them so that its end knows what comes
BATCH_SIZE = 64
TRIES = 4  # of more and more damping on one linearisation


def solve_clip(
    objective: Objective,
    coordinates: Tensor,
    start: Tensor,
    smoothness: float,
    steps: int = 12,
    mean_steps: int = 0,
    window: int = WINDOW,
    lookahead: int = LOOKAHEAD,
    tolerance: float = 1e-4,
    weights: Tensor | None = None,
    numbers: Tensor | None = None,
) -> Tensor:
    """Minimise the objective of all frames plus half of `smoothness` times the squared second differences of the controls.

    Long clips are solved window by window, so that memory stays bounded. A window goes on from the last two frames that the
    one before has kept, and looks beyond its own end; what it finds there is where the next one starts. The influence of a
    frame fades within the look-ahead, so the result is that of one solve without windows.

    Args:
        coordinates: `(frame, coordinate)`; frames with NaN or infinite values only follow their neighbours.
        start: `(frame, control)` in shares of their ranges.
        smoothness: mm^2, as the mean squared vertex distance, for one control with a second difference of its whole range.
        steps: Gauss-Newton steps, at most.
        mean_steps: as many at most, once that is done, in which every vertex counts by its distance and not by the square.
        window, lookahead: frames.
        tolerance: a window is done once a step lowers its objective by less than this share.
        weights: what the distance of each frame counts, `(frame,)`: less where a capture is to be trusted less, 0 where it only
            follows its neighbours; 1 for all unless given.
        numbers: of the frames, `(frame,)`, rising: second differences go by time, and across long gaps there are none; None:
            no frame is missing.

    Returns:
        Controls `(frame, control)` in shares of their ranges.
    """
    found = start.clamp(0, 1)
    weights = found.new_ones(len(found)) if weights is None else weights.to(found)
    steps_apart = usual_steps(torch.arange(len(found)) if numbers is None else numbers).to(found.device)
    by_mean_distance = objective.by_mean_distance() if mean_steps else None
    for first in range(0, len(found), window):
        stop = min(first + window + lookahead, len(found))
        if len(found) - stop <= lookahead:
            stop = len(found)  # no window is left with less than its own look-ahead
        rows, known = slice(first, stop), max(first - 2, 0)
        apart = steps_apart[known : stop - 1]
        part = _Window(
            objective, coordinates[rows], weights[rows], found[known:first], smoothness * objective.vertex_count, apart
        )
        found[rows] = part.solve(found[rows], steps, tolerance)
        if by_mean_distance is not None:
            part.objective = by_mean_distance
            found[rows] = part.solve(found[rows], mean_steps, tolerance)
        if stop == len(found):
            break
    return found


class _Window:
    """Some frames in a row, and up to two before them that are settled.

    Args:
        steps: how far these and those before them lie apart, as of `usual_steps`.
    """

    def __init__(
        self, objective: Objective, coordinates: Tensor, weights: Tensor, before: Tensor, smoothness: float, steps: Tensor
    ) -> None:
        self.objective, self.before, self.smoothness, self.weights = objective, before.clone(), smoothness, weights
        self.seen = torch.isfinite(coordinates).all(dim=1)
        self.coordinates = torch.where(self.seen[:, None], coordinates, 0.0)
        differences = second_differences(steps)
        self.differences = differences.to(coordinates)
        self.bands = [smoothness * band for band in second_difference_bands(len(coordinates), len(before), differences)]

    def solve(self, at: Tensor, steps: int, tolerance: float) -> Tensor:
        damping = torch.full((len(at),), START_DAMPING, dtype=at.dtype)
        for _ in range(steps):
            near = self._linearise(at)
            gradient = near.gradient + self._pull(at)
            before = near.cost.sum() + self._roughness(at)
            for _ in range(TRIES):
                step = self._step(near.hessian, gradient, damping, at)
                cost = self._cost(at + step)
                after = cost.sum() + self._roughness(at + step)
                foreseen = (near.gradient * step).sum(dim=1) + 0.5 * (step * (near.hessian @ step[..., None])[..., 0]).sum(
                    dim=1
                )
                trusted = (cost - near.cost - foreseen) < 0.25 * foreseen.abs()
                if after < before:
                    damping = torch.where(trusted, damping / 4, damping * 4).clamp(LEAST_DAMPING, MOST_DAMPING)
                    at = at + step
                    break
                damping = torch.where(trusted, damping * 2, damping * 10).clamp(LEAST_DAMPING, MOST_DAMPING)
            else:
                break
            if before - after < tolerance * before:
                break
        return at

    def _linearise(self, at: Tensor) -> Linearised:
        pieces = self.objective.at_once([lambda piece=piece: self.objective.linearise(*piece) for piece in self._batches(at)])
        near = Linearised(*(torch.cat(parts) for parts in zip(*pieces)))
        for values in near:
            values[~self.seen] = 0
        return near

    def _cost(self, at: Tensor) -> Tensor:
        pieces = self.objective.at_once([lambda piece=piece: self.objective.cost(*piece) for piece in self._batches(at)])
        return torch.where(self.seen, torch.cat(pieces), 0.0)

    def _batches(self, at: Tensor) -> Iterator[tuple[Tensor, ...]]:
        return zip(*(values.split(BATCH_SIZE) for values in (at, self.coordinates, self.weights)))

    def _differences(self, at: Tensor) -> Tensor:
        curve = torch.cat([self.before, at])
        to_first, to_middle, to_last = self.differences[:, :, None].unbind(dim=1)
        return to_last * curve[2:] + to_middle * curve[1:-1] + to_first * curve[:-2]

    def _roughness(self, at: Tensor) -> Tensor:
        return 0.5 * self.smoothness * self._differences(at).square().sum()

    def _pull(self, at: Tensor) -> Tensor:
        """The gradient of the roughness, `(frame, control)`."""
        second = self.smoothness * self._differences(at)
        result = at.new_zeros(len(self.before) + len(at), at.shape[1])
        if len(second):
            to_first, to_middle, to_last = self.differences[:, :, None].unbind(dim=1)
            result[2:] += to_last * second
            result[1:-1] += to_middle * second
            result[:-2] += to_first * second
        return result[len(self.before) :]

    def _step(self, hessian: Tensor, gradient: Tensor, damping: Tensor, at: Tensor) -> Tensor:
        """As `box_step`, for all frames together."""
        main, near, far = self.bands
        diagonal = hessian.diagonal(dim1=1, dim2=2)
        floor = FLOOR * diagonal.mean(dim=1, keepdim=True) + 1e-6
        added = (damping[:, None] * (diagonal + floor) + main[:, None]).double()
        return band_box_step(hessian.double(), added, near, far, gradient, at, self.objective.at_once)
