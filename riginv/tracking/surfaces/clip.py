"""All scans of a clip at once: smooth curves on the frames' normal equations, rigid motion eliminated from each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.solvers.band import second_difference_bands, second_differences
from riginv.solvers.band_step import band_box_step
from riginv.tracking.surfaces.fitting import SHIFT_MM, TURN, Linearised, State, SurfaceFit
from riginv.tracking.surfaces.matching import Target, match
from riginv.tracking.surfaces.quality import quality
from riginv.tracking.surfaces.solving import ScanSolver, SolvedScan

Load = Callable[[int], Target | None]  # the scan of a frame, prepared; None where there is none
DAMPING = 1e-3  # relative to the diagonal
BROAD = 5.0  # times the mean distance of a scan from the rig: the scale of Geman and McClure's weights
WINDOW, LOOKAHEAD = 160, 32  # frames that are kept of a window, and those solved beyond them


@dataclass(frozen=True)
class ScanSmoothness:
    """How smooth the curves of a clip of scans are.

    Attributes:
        smoothness: mm^2 of mean squared distance, for one control with a second difference of its whole range.
        rounds: of matching and solving.
        reach: of a control's range, at most in one round.
        break_mm: mean second difference of the skin between three frames, above which they are not taken for neighbours in
            time: a clip of single poses is not smoothed.
    """

    smoothness: float = 0.3
    rounds: int = 2
    reach: float = 0.1
    break_mm: float = 1.0


class Reduced(NamedTuple):
    """The normal equations of one frame's controls, prior included, and how its rigid motion follows them.

    Attributes:
        hessian, gradient: `(control, control)` and `(control,)`.
        follow: rigid motion for the gradient alone, and its derivative by the controls, `(motion, 1 + control)`.
    """

    hessian: Tensor
    gradient: Tensor
    follow: Tensor


def smooth_scans(
    solver: ScanSolver,
    load: Load,
    found: Sequence[SolvedScan | None],
    how: ScanSmoothness,
    advance: Callable[[int], None] = lambda frames: None,
) -> list[SolvedScan]:
    """Minimise the robust distance of all scans, the prior, and the squared second differences of the controls.

    Args:
        load: asked for each frame once a round.
        found: each frame's own answer; None where it has no scan: it follows its neighbours.
        advance: told how many frames are done.
    """
    result = _filled(found)
    for first in range(0, len(result), WINDOW):
        stop = min(first + WINDOW + LOOKAHEAD, len(result))
        stop = len(result) if len(result) - stop <= LOOKAHEAD else stop
        _Window(solver, load, result, first, stop, how).solve(advance)
        if stop == len(result):
            break
    return result


class _Window:
    """The frames `first` to `stop` of a clip, after up to two that are settled."""

    def __init__(
        self, solver: ScanSolver, load: Load, result: list[SolvedScan], first: int, stop: int, how: ScanSmoothness
    ) -> None:
        self.solver, self.load, self.result, self.how = solver, load, result, how
        self.before = min(2, first)
        self.frames = range(first, stop)
        every = range(first - self.before, stop)
        skin = np.stack([_skin(solver, result[frame].state) for frame in every])
        second = np.linalg.norm(skin[2:] - 2 * skin[1:-1] + skin[:-2], axis=2).mean(axis=1)
        self.weights = torch.from_numpy(how.smoothness * (second < how.break_mm))
        differences = second_differences(torch.ones(len(every) - 1, dtype=torch.float64))
        self.bands = second_difference_bands(len(self.frames), self.before, self.weights.sqrt()[:, None] * differences)

    def solve(self, advance: Callable[[int], None]) -> None:
        for number in range(self.how.rounds):
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
        fit = self.solver.fit(target)
        schedule = self.solver.settings.from_near
        scale = max(schedule.last_scale_mm, BROAD * float(np.nan_to_num(found.quality.scan_mm)))
        posed = fit.surface.posed(fit.coefficients(found.state.units))
        pairs = match(fit.surface, posed, target, found.state.motion, scale, schedule.degrees)
        return eliminate_motion(fit, Linearised(fit, found.state, pairs))

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
        pull = torch.zeros_like(curve)
        pull[2:] += second
        pull[1:-1] -= 2 * second
        pull[:-2] += second
        blocks = torch.stack([each.hessian for each in reduced])
        diagonal = blocks.diagonal(dim1=1, dim2=2)
        added = DAMPING * diagonal + main[:, None]
        gradient = torch.stack([each.gradient for each in reduced]) + pull[self.before :]
        step = band_box_step(blocks, added, near, far, gradient, units).clamp(-self.how.reach, self.how.reach)
        for frame, change, each in zip(self.frames, step, reduced):
            self.result[frame] = replace(self.result[frame], state=_moved(self.solver, self.result[frame].state, change, each))


def eliminate_motion(fit: SurfaceFit, near: Linearised) -> Reduced:
    """The normal equations of the controls once rigid motion follows them as well as it can."""
    count, (_, gradient, hessian) = len(near.state.units), near.normal
    motion = hessian[count:, count:]
    motion = motion + 1e-9 * motion.diagonal().mean() * torch.eye(len(motion), dtype=torch.float64)
    ours, across = hessian[:count, :count] + fit.prior.precision, hessian[count:, :count]
    pull = gradient[:count] + fit.prior.gradient(near.state.units[None])[0]
    follow = -torch.linalg.solve(motion, torch.cat([gradient[count:, None], across], dim=1))
    return Reduced(ours + across.T @ follow[:, 1:], pull + across.T @ follow[:, 0], follow)


def _moved(solver: ScanSolver, state: State, change: Tensor, reduced: Reduced) -> State:
    motion = state.motion
    if len(reduced.follow):
        turn, shift = (reduced.follow[:, 0] + reduced.follow[:, 1:] @ change).numpy().reshape(2, 3)
        motion = motion.after(turn * TURN, shift * SHIFT_MM, solver.surface.centre)
    return State((state.units + change).clamp(0, 1), motion)


def _filled(found: Sequence[SolvedScan | None]) -> list[SolvedScan]:
    """Frames without an answer start from that of the nearest frame that has one."""
    known = np.array([number for number, each in enumerate(found) if each is not None])
    return [found[known[np.abs(known - number).argmin()]] for number in range(len(found))]


def _skin(solver: ScanSolver, state: State) -> np.ndarray:
    fit = solver.fit_of(1.0)
    return solver.surface.vertices(fit.coefficients(state.units))[solver.surface.sampled].astype(np.float32)
