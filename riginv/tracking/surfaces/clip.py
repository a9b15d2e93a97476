"""Smooth curves for all scans of a clip, from the normal equations of the frames, with rigid motion eliminated."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.solvers.band import second_difference_bands, second_differences
from riginv.solvers.band_step import band_box_step
from riginv.tracking.surfaces.fitting import ROTATION, SHIFT_MM, Linearised, State, SurfaceFit
from riginv.tracking.surfaces.limited_cache import LimitedCache
from riginv.tracking.surfaces.matching import Target, match
from riginv.tracking.surfaces.quality import quality
from riginv.tracking.surfaces.solving import ScanSolver, SolvedScan

Load = Callable[[int], Target | None]  # the scan of a frame; None where there is none
DAMPING = 1e-3  # relative to the diagonal
SCALE = 5.0  # scale of Geman and McClure's weights, in mean distances of a scan from the rig
WINDOW, LOOKAHEAD = 160, 32  # frames of a window, and frames after it that are solved with it


@dataclass(frozen=True)
class ScanSmoothness:
    """Smoothness of the curves of a clip of scans.

    Attributes:
        smoothness: mm^2 of mean squared distance for a second difference of a control's whole range.
        rounds: iterations of matching and solving.
        max_step: of a control in one iteration, as a fraction of its range.
        break_mm: mean second difference of the skin over three frames above which they are no neighbours in time. Where it is
            greater in most frames, the clip consists of single poses, and nothing is smoothed.
    """

    smoothness: float = 0.3
    rounds: int = 2
    max_step: float = 0.1
    break_mm: float = 1.0


class Reduced(NamedTuple):
    """The normal equations of a frame's controls, prior included, with rigid motion eliminated.

    Attributes:
        hessian, gradient: `(control, control)` and `(control,)`.
        follow: the eliminated rigid motion: its offset and its derivative by the controls, `(motion, 1 + control)`.
    """

    hessian: Tensor
    gradient: Tensor
    follow: Tensor


def smooth_scans(
    solver: ScanSolver,
    scans: LimitedCache[Target | None],
    found: Sequence[SolvedScan | None],
    options: ScanSmoothness,
    advance: Callable[[int], None] = lambda frames: None,
) -> list[SolvedScan]:
    """Minimise the robust distance of all scans, the prior, and the squared second differences of the controls.

    Args:
        scans: the scan of each frame, from `cached_scans`.
        found: the solution of each frame; None where it has no scan: it follows its neighbours.
        advance: reports progress.
    """
    result = nearest_known(found)
    for first in range(0, len(result), WINDOW):
        scans.drop_before(first)
        stop = min(first + WINDOW + LOOKAHEAD, len(result))
        stop = len(result) if len(result) - stop <= LOOKAHEAD else stop
        _Window(solver, scans, result, first, stop, options).solve(advance)
        if stop == len(result):
            break
    return result


def cached_scans(load: Load) -> LimitedCache[Target | None]:
    """Scans that are kept in memory as far as there is room."""
    return LimitedCache(load, lambda target: 0 if target is None else len(target.surface.points))


class _Window:
    """The frames `first` to `stop` of a clip, after up to two frames that are fixed."""

    def __init__(
        self, solver: ScanSolver, load: Load, result: list[SolvedScan], first: int, stop: int, options: ScanSmoothness
    ) -> None:
        self.solver, self.load, self.result, self.options = solver, load, result, options
        self.before = min(2, first)
        self.frames = range(first, stop)
        every = range(first - self.before, stop)
        skin = np.stack([_skin(solver, result[frame].state) for frame in every])
        second = np.linalg.norm(skin[2:] - 2 * skin[1:-1] + skin[:-2], axis=2).mean(axis=1)
        in_time = (second < options.break_mm) & bool(np.median(second) < options.break_mm)
        self.is_smoothed = bool(in_time.any())
        self.weights = torch.from_numpy(options.smoothness * in_time)
        differences = second_differences(torch.ones(len(every) - 1, dtype=torch.float64))
        self.bands = second_difference_bands(len(self.frames), self.before, self.weights.sqrt()[:, None] * differences)

    def solve(self, advance: Callable[[int], None]) -> None:
        for number in range(self.options.rounds):
            reduced = []
            for frame in self.frames:
                reduced.append(self._reduce(frame))
                advance(int(number == 0))
            self._move(reduced)
        for frame in self.frames:
            target = self.load(frame)
            if target is not None:
                state = self.result[frame].state
                self.result[frame] = replace(self.result[frame], quality=quality(self.solver.fit(target), target, state))

    def _reduce(self, frame: int) -> Reduced:
        target, found = self.load(frame), self.result[frame]
        if target is None:
            return self._prior_alone(found)
        if not self.is_smoothed:  # neighbours lower the effect of noise, too
            target = self.solver.finer(target)
        fit = self.solver.fit(target, found)
        schedule = self.solver.settings.from_near
        scale = max(schedule.last_scale_mm, SCALE * float(np.nan_to_num(found.quality.scan_mm)))
        posed = fit.posed(found.state)
        pairs = match(fit.surface, posed, target, found.state.motion, scale, schedule.degrees)
        landmarks = target.landmark_term(fit.surface, posed, found.state.motion, scale)
        return eliminate_motion(fit, Linearised(fit, found.state, pairs, landmarks))

    def _prior_alone(self, found: SolvedScan) -> Reduced:
        fit = self.solver.fit_of(1.0)
        count = len(found.state.units)
        gradient = fit.prior.gradient(found.state.units[None])[0]
        return Reduced(fit.prior.precision, gradient, torch.zeros(0, 1 + count, dtype=torch.float64))

    def _move(self, reduced: list[Reduced]) -> None:
        """One step for all frames of the window."""
        main, near, far = self.bands
        units = torch.stack([self.result[frame].state.units for frame in self.frames])
        before = [self.result[frame].state.units for frame in range(self.frames[0] - self.before, self.frames[0])]
        curve = torch.cat([torch.stack(before), units]) if before else units
        second = self.weights[:, None] * (curve[2:] - 2 * curve[1:-1] + curve[:-2])
        force = torch.zeros_like(curve)
        force[2:] += second
        force[1:-1] -= 2 * second
        force[:-2] += second
        blocks = torch.stack([each.hessian for each in reduced])
        diagonal = blocks.diagonal(dim1=1, dim2=2)
        added = DAMPING * diagonal + main[:, None]
        gradient = torch.stack([each.gradient for each in reduced]) + force[self.before :]
        step = band_box_step(blocks, added, near, far, gradient, units).clamp(-self.options.max_step, self.options.max_step)
        for frame, change, each in zip(self.frames, step, reduced):
            self.result[frame] = replace(self.result[frame], state=_apply(self.solver, self.result[frame].state, change, each))


def eliminate_motion(fit: SurfaceFit, near: Linearised) -> Reduced:
    """Eliminate rigid motion from the normal equations: it takes its optimum for any controls."""
    count, (_, gradient, hessian) = len(near.state.units), near.normal
    motion = hessian[count:, count:]
    motion = motion + 1e-9 * motion.diagonal().mean() * torch.eye(len(motion), dtype=torch.float64)
    ours, across = hessian[:count, :count] + fit.prior.precision, hessian[count:, :count]
    pull = gradient[:count] + fit.prior.gradient(near.state.units[None])[0]
    follow = -torch.linalg.solve(motion, torch.cat([gradient[count:, None], across], dim=1))
    return Reduced(ours + across.T @ follow[:, 1:], pull + across.T @ follow[:, 0], follow)


def _apply(solver: ScanSolver, state: State, change: Tensor, reduced: Reduced) -> State:
    motion = state.motion
    if len(reduced.follow):
        rotation, shift = (reduced.follow[:, 0] + reduced.follow[:, 1:] @ change).numpy().reshape(2, 3)
        motion = motion.after(rotation * ROTATION, shift * SHIFT_MM, solver.surface.centre)
    return State((state.units + change).clamp(0, 1), motion)


def nearest_known(found: Sequence[SolvedScan | None]) -> list[SolvedScan]:
    """The solution of each frame, or of the nearest frame that has one."""
    known = {row: each for row, each in enumerate(found) if each is not None}
    rows = np.array(list(known))
    return [known[int(rows[np.abs(rows - row).argmin()])] for row in range(len(found))]


def _skin(solver: ScanSolver, state: State) -> np.ndarray:
    fit = solver.fit_of(1.0)
    return solver.surface.vertices(fit.coefficients(state.units))[solver.surface.sampled].astype(np.float32)
