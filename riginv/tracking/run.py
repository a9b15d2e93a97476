"""Inversion of a clip, window by window; controls, motion and errors of each frame are kept."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from riginv.animation.animation import FrameErrors
from riginv.clips.clip import Clip
from riginv.errors import InputError
from riginv.runs.threads import workers
from riginv.solvers.clip import smoothed, solve_clip
from riginv.solvers.levenberg_marquardt import Solution
from riginv.tracking.alternation import WindowInverter, WindowResult, interpolate_controls, interpolate_motion
from riginv.tracking.estimators import SolverEstimator
from riginv.tracking.frame_evaluation import FrameEvaluator
from riginv.tracking.options import SolverOptions
from riginv.tracking.rigid import fit_rigid

PARTS = 2  # windows at once, for as many threads
Advance = Callable[[str, int], None]  # receives the name of a pass, and the number of its finished frames


@dataclass(frozen=True)
class Inversion:
    """The inversion of a clip.

    Attributes:
        controls: `(frame, control)`, within the rig's limits.
        motion: `(frame, 4, 4)`, or None.
        errors: of each frame.
    """

    controls: Tensor
    motion: Tensor | None
    errors: FrameErrors


def invert_clip(clip: Clip, inverter: WindowInverter, evaluator: FrameEvaluator, window: int, advance: Advance) -> Inversion:
    """Invert and evaluate each frame on its own.

    Args:
        window: frames that a thread has in memory at a time.
        advance: reports progress.
    """
    results = _FrameResults(len(clip), inverter)

    def invert(first: int, vertices: Tensor) -> None:
        with torch.no_grad():
            inverted = inverter.invert(vertices)
        evaluator.add(first, inverted)
        results.add(first, inverted)

    at_once = PARTS if inverter.estimator.frames_are_independent and evaluator.true_rig is evaluator.rig else 1
    windows = clip.batches(at_once * window)
    following = next(windows, None)
    while following is not None:
        first, vertices = following
        if at_once == 1:  # solvers have threads of their own
            invert(first, vertices)
            following = next(windows, None)
        else:
            starts = torch.arange(first, first + len(vertices)).tensor_split(at_once)
            parts = [partial(invert, int(rows[0]), vertices[rows - first]) for rows in starts if len(rows)]
            following = workers().run([*parts, partial(next, windows, None)])[-1]
        advance("inverting", len(vertices))
    results.check(clip)
    results.controls = _continuous(inverter, results.controls)
    return results.finished(interpolate_controls(results.controls, results.known, clip.frame_numbers), clip, evaluator)


def invert_smoothly(
    clip: Clip,
    inverter: WindowInverter,
    evaluator: FrameEvaluator,
    window: int,
    advance: Advance,
    options: SolverOptions,
) -> Inversion:
    """Invert all frames together with smooth curves: each frame on its own first, then all in mesh coordinates.

    The clip is read twice. Its mesh coordinates, a fortieth of it for the default face, are kept in between.
    """
    estimator = inverter.estimator
    if not isinstance(estimator, SolverEstimator):
        raise TypeError("a whole clip is for solvers")
    results, size = _FrameResults(len(clip), inverter), estimator.space.size
    coordinates, converged = torch.full((len(clip), size), torch.nan), torch.zeros(len(clip), dtype=torch.bool)
    for first, vertices in clip.batches(window):
        inverted = inverter.invert(vertices)
        results.add(first, inverted)
        rows = slice(first, first + len(vertices))
        coordinates[rows] = torch.where(inverted.solvable[:, None], estimator.space.encode(inverted.filled), torch.nan)
        converged[rows] = estimator.converged(inverted.filled, inverted.controls)  # of the frame alone
        advance("each frame", len(vertices))
    results.check(clip)
    results.controls = _continuous(inverter, results.controls)
    if estimator.is_exact(coordinates, results.controls):  # made by the rig itself: smoothing would only move it away
        controls = interpolate_controls(results.controls, results.known, clip.frame_numbers)
        return _evaluated(controls, converged, results, clip, inverter, evaluator, window, advance)
    start = Solution.at_neutral(estimator.objective, len(clip))
    start.units, start.skipped = estimator.units(results.controls), ~results.known
    advance("the whole clip", 0)
    begin = smoothed(start, options.blur, clip.frame_numbers)
    steps = (options.smoothness, options.clip_steps, options.mean_steps)
    smooth = solve_clip(
        estimator.objective,
        coordinates,
        begin,
        *steps,
        numbers=clip.frame_numbers,
        full_smoothness_mm=options.full_smoothness_mm,
        own=start.units,
    )
    return _evaluated(estimator.controls(smooth), converged, results, clip, inverter, evaluator, window, advance)


def _continuous(inverter: WindowInverter, controls: Tensor) -> Tensor:
    """The same controls without jumps between equal angles, where all are free to change."""
    estimator = inverter.estimator
    if not isinstance(estimator, SolverEstimator) or len(estimator.rig.free) < controls.shape[1]:
        return controls
    return inverter.rig.continuous(controls)


def _evaluated(
    controls: Tensor,
    converged: Tensor,
    results: "_FrameResults",
    clip: Clip,
    inverter: WindowInverter,
    evaluator: FrameEvaluator,
    window: int,
    advance: Advance,
) -> Inversion:
    """The inversion with final controls `(frame, control)`, evaluated frame by frame."""
    for first, vertices in clip.batches(window):
        rows = slice(first, first + len(vertices))
        inverted = _with_controls(vertices, controls[rows], inverter, results.known[rows])
        evaluator.add(first, inverted, converged[rows])
        results.add(first, inverted)
        advance("evaluating", len(vertices))
    return results.finished(controls, clip, evaluator)


def _with_controls(vertices: Tensor, controls: Tensor, inverter: WindowInverter, known: Tensor) -> WindowResult:
    """The result for final controls and the rigid motion that fits them best."""
    motion = None
    if inverter.anchors is not None:
        anchors = inverter.anchors.for_window(torch.isfinite(vertices[known]).all(dim=2))
        motion = fit_rigid(anchors.mesh(controls), vertices[:, anchors.vertices], anchors.weights)
    return inverter.result(vertices, controls, motion, known)


class _FrameResults:
    """Controls and motion of all frames; allocated once, so that windows do not fragment memory."""

    def __init__(self, frames: int, inverter: WindowInverter) -> None:
        self.controls = torch.zeros(frames, len(inverter.rig.controls), dtype=inverter.rig.dtype)
        self.motion = None if inverter.anchors is None else torch.zeros(frames, 4, 4, dtype=inverter.rig.dtype)
        self.known = torch.zeros(frames, dtype=torch.bool)

    def add(self, first: int, inverted: WindowResult) -> None:
        """Store the frames of a window that starts at `first`."""
        rows = slice(first, first + len(inverted.controls))
        self.controls[rows], self.known[rows] = inverted.controls, inverted.solvable
        if self.motion is not None and inverted.motion is not None:
            self.motion[rows] = inverted.motion

    def check(self, clip: Clip) -> None:
        """Raise InputError where no frame could be solved."""
        if not bool(self.known.any()):
            raise InputError(f"{clip.sequence.path}: no frame has enough known vertices: there is nothing to invert")

    def finished(self, controls: Tensor, clip: Clip, evaluator: FrameEvaluator) -> Inversion:
        motion = None if self.motion is None else interpolate_motion(self.motion, self.known, clip.frame_numbers)
        rig = evaluator.true_rig
        return Inversion(controls.clamp(rig.lower, rig.upper), motion, evaluator.errors(clip.frame_numbers))
