"""Solving a clip as a whole: small errors and smooth curves."""

from collections.abc import Iterator
from functools import partial

import torch
from jaxtyping import Float, Shaped
from torch import Tensor
from torch.nn.functional import max_pool1d

from riginv.solvers.band import second_difference_bands, second_differences, spans, usual_steps
from riginv.solvers.band_step import band_box_step
from riginv.solvers.box_step import FLOOR
from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.levenberg_marquardt import LEAST_DAMPING, MOST_DAMPING, START_DAMPING, Solution
from riginv.solvers.objective import Linearised, Objective

WINDOW, LOOKAHEAD = 192, 48  # frames that are kept of a window, and those that are solved beyond them
BATCH_SIZE = 64
TRIES = 4  # of increasing damping on one linearisation
OWN_STEPS = 10  # to a frame's own solution, at most
LEAST_SMOOTHNESS = 1e-4  # as a fraction, for frames that the rig makes exactly: controls without effect remain smooth
NEARBY = 8  # frames on either side of one that the rig cannot make, which are smoothed like it


def solve_clip(
    objective: Objective,
    coordinates: Float[Tensor, "frame coordinate"],
    start: Float[Tensor, "frame control"],
    smoothness: float,
    steps: int = 12,
    mean_steps: int = 0,
    window: int = WINDOW,
    lookahead: int = LOOKAHEAD,
    tolerance: float = 1e-4,
    weights: Float[Tensor, " frame"] | None = None,
    numbers: Shaped[Tensor, " frame"] | None = None,
    full_smoothness_mm: float = 0.0,
    own: Float[Tensor, "frame control"] | None = None,
    changes: Float[Tensor, "control control"] | None = None,
) -> Float[Tensor, "frame control"]:
    """Minimise the objective of all frames plus half of `smoothness` times the squared second differences of the controls.

    Long clips are solved in windows, so that memory is bounded. A window continues the last two kept frames of the one before,
    and is solved with a look-ahead, whose result is the next one's start. The influence of a frame fades within the look-ahead,
    so the result equals a solve without windows.

    Args:
        coordinates: frames with NaN or infinite values are interpolated.
        start: as fractions of the controls' ranges.
        smoothness: mm^2, as the mean squared vertex distance, for one control with a second difference of its whole range.
        steps: Gauss-Newton steps, at most.
        mean_steps: further steps, at most, on the mean distance in place of the mean squared distance.
        window, lookahead: frames.
        tolerance: a window has converged once a step reduces its objective by less than this fraction.
        weights: of each frame's distance: lower for less reliable frames, 0: interpolated. None: 1.
        numbers: frame numbers, ascending, for second differences by time, with none across long gaps; None: no frame
            is missing.
        full_smoothness_mm: root mean square distance of a frame's own solution at which it is smoothed in full; below, in
            proportion to the squared distance, since fast motion that the rig makes exactly is not noise. 0: all in full.
        own: near each frame's own solution, which is sought from there; None: from the start.
        changes: covariance of the controls' second differences: `smoothness` is then mm^2 for one standard deviation of a
            combination of controls; None: for the whole range of each.

    Returns:
        Controls `(frame, control)`, as fractions of their ranges.
    """
    units = start.clamp(0, 1)
    weights = units.new_ones(len(units)) if weights is None else weights.to(units)
    frame_steps = usual_steps(torch.arange(len(units)) if numbers is None else numbers).to(units.device)
    by_mean_distance = objective.by_mean_distance() if mean_steps else None
    fractions = torch.ones_like(weights)
    root = None if changes is None else torch.linalg.cholesky(changes.double())
    for first in range(0, len(units), window):
        stop = min(first + window + lookahead, len(units))
        if len(units) - stop <= lookahead:
            stop = len(units)  # no window is shorter than its look-ahead
        rows, fixed_from = slice(first, stop), max(first - 2, 0)
        scaled = smoothness * objective.squared_mm
        before, steps_between = units[fixed_from:first], frame_steps[fixed_from : stop - 1]
        frames = _Window(objective, coordinates[rows], weights[rows], before, scaled, steps_between, root)
        if full_smoothness_mm:
            alone, fractions[rows] = frames.own_solutions((units if own is None else own)[rows], full_smoothness_mm)
            fraction = max_pool1d(fractions[None, fixed_from:stop], 2 * NEARBY + 1, 1, NEARBY)[0]
            units[rows] = torch.lerp(alone, units[rows], fraction[first - fixed_from :, None])
            frames.scale_smoothness(fraction)
        units[rows] = frames.solve(units[rows], steps, tolerance)
        if by_mean_distance is not None:
            frames.objective = by_mean_distance
            units[rows] = frames.solve(units[rows], mean_steps, tolerance)
        if stop == len(units):
            break
    return units


class _Window:
    """Consecutive frames, and up to two solved ones before them.

    Args:
        steps: between these frames and those before them, from `usual_steps`.
        root: a Cholesky factor of the covariance of second differences; None: the identity.
    """

    def __init__(
        self,
        objective: Objective,
        coordinates: Tensor,
        weights: Tensor,
        before: Tensor,
        smoothness: float,
        steps: Tensor,
        root: Tensor | None,
    ) -> None:
        self.root = root
        self.whiten = None if root is None else torch.linalg.inv(root).T.to(before)
        self.objective, self.before, self.smoothness, self.weights = objective, before.clone(), smoothness, weights
        self.finite = torch.isfinite(coordinates).all(dim=1)
        self.coordinates = torch.where(self.finite[:, None], coordinates, 0.0)
        self._set_differences(second_differences(steps))

    def _set_differences(self, differences: Tensor) -> None:
        self.differences = differences.to(self.coordinates)
        bands = second_difference_bands(len(self.coordinates), len(self.before), differences)
        self.bands = [self.smoothness * band for band in bands]

    def own_solutions(self, at: Tensor, full_mm: float) -> tuple[Tensor, Tensor]:
        """Each frame's own solution from `at`, and the fraction of the smoothness that suits its distance, `(frame,)`."""
        own = refine_meshes(self.objective, self.coordinates, at, OWN_STEPS)
        squared_mm = 2 * (own.cost - self.objective.prior_cost(own.units)) / self.objective.squared_mm
        fractions = (squared_mm / full_mm**2).clamp(LEAST_SMOOTHNESS, 1)
        return own.units, torch.where(self.finite & (self.weights >= 1), fractions, 1.0)

    def scale_smoothness(self, fractions: Tensor) -> None:
        """Scale the smoothness at these frames and those before them by fractions `(frame,)`."""
        self._set_differences(fractions[1:-1].double().sqrt()[:, None] * self.differences.double())

    def solve(self, at: Tensor, steps: int, tolerance: float) -> Tensor:
        damping = torch.full((len(at),), START_DAMPING, dtype=at.dtype)
        for _ in range(steps):
            near = self._linearise(at)
            gradient = near.gradient + self._roughness_gradient(at)
            before = near.cost.sum() + self._roughness(at)
            for _ in range(TRIES):
                step = self._step(near.hessian, gradient, damping, at)
                cost = self._cost(at + step)
                after = cost.sum() + self._roughness(at + step)
                curvature = (step * (near.hessian @ step[..., None])[..., 0]).sum(dim=1)
                predicted = (near.gradient * step).sum(dim=1) + 0.5 * curvature
                trusted = (cost - near.cost - predicted) < 0.25 * predicted.abs()
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
        results = self.objective.run_tasks([partial(self.objective.linearise, *batch) for batch in self._batches(at)])
        near = Linearised(*(torch.cat(values) for values in zip(*results)))
        for values in near:
            values[~self.finite] = 0
        return near

    def _cost(self, at: Tensor) -> Tensor:
        costs = self.objective.run_tasks([partial(self.objective.cost, *batch) for batch in self._batches(at)])
        return torch.where(self.finite, torch.cat(costs), 0.0)

    def _batches(self, at: Tensor) -> Iterator[tuple[Tensor, ...]]:
        return zip(*(values.split(BATCH_SIZE) for values in (at, self.coordinates, self.weights)))

    def _differences(self, at: Tensor) -> Tensor:
        curve = torch.cat([self.before, at])
        to_first, to_middle, to_last = self.differences[:, :, None].unbind(dim=1)
        return to_last * curve[2:] + to_middle * curve[1:-1] + to_first * curve[:-2]

    def _roughness(self, at: Tensor) -> Tensor:
        second = self._differences(at)
        return 0.5 * self.smoothness * (second if self.whiten is None else second @ self.whiten).square().sum()

    def _roughness_gradient(self, at: Tensor) -> Tensor:
        """`(frame, control)`."""
        second = self.smoothness * self._differences(at)
        if self.whiten is not None:
            second = second @ self.whiten @ self.whiten.T
        result = at.new_zeros(len(self.before) + len(at), at.shape[1])
        if len(second):
            to_first, to_middle, to_last = self.differences[:, :, None].unbind(dim=1)
            result[2:] += to_last * second
            result[1:-1] += to_middle * second
            result[:-2] += to_first * second
        return result[len(self.before) :]

    def _step(self, hessian: Tensor, gradient: Tensor, damping: Tensor, at: Tensor) -> Tensor:
        main, near, far = self.bands
        diagonal = hessian.diagonal(dim1=1, dim2=2)
        floor = FLOOR * diagonal.mean(dim=1, keepdim=True) + 1e-6
        added = (damping[:, None] * (diagonal + floor)).double()
        return band_box_step(hessian.double(), added, near, far, gradient, at, self.objective.run_tasks, main, self.root)


def smoothed(
    solution: Solution, blur: float, numbers: Shaped[Tensor, " frame"] | None = None
) -> Float[Tensor, "frame control"]:
    """The controls `(frame, control)` of a clip, blurred over time, without skipped frames.

    Args:
        blur: standard deviation of the Gaussian, frames; 0: none.
        numbers: frame numbers: curves are not blurred across long gaps; None: no frame is missing.
    """
    if not len(solution.units):
        return solution.units
    radius = max(1, round(3 * blur))
    offset = torch.arange(-radius, radius + 1, dtype=solution.units.dtype)
    kernel = torch.exp(-0.5 * (offset / max(blur, 1e-3)) ** 2)
    known = (~solution.skipped).to(kernel)[:, None]
    values = torch.cat([solution.units * known, known], dim=1)
    parts = spans(torch.arange(len(values)) if numbers is None else numbers)
    total = torch.cat([_blurred(values[rows], kernel) for rows in parts])
    near = total[:, :-1] / total[:, -1:].clamp_min(1e-12)
    return torch.where(total[:, -1:] > 1e-12, near, solution.units)


def _blurred(values: Tensor, kernel: Tensor) -> Tensor:
    return torch.nn.functional.conv1d(values.T[:, None], kernel[None, None], padding=len(kernel) // 2)[:, 0].T
