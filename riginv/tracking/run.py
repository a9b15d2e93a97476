"""A clip from end to end, window by window; only controls, motion and errors are kept of each frame."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.animation.animation import FrameErrors
from riginv.clips.clip import Clip
from riginv.errors import InputError
from riginv.solvers.clip import solve_clip
from riginv.solvers.levenberg_marquardt import Solution
from riginv.solvers.smoothing import smoothed
from riginv.tracking.alternation import Found, WindowInverter, interpolate_controls, interpolate_motion
from riginv.tracking.estimators import SolverEstimator
from riginv.tracking.frame_evaluation import FrameEvaluator
from riginv.tracking.rigid import fit_rigid


@dataclass(frozen=True)
class Inversion:
    """What came of a clip.

    Attributes:
        controls: `(frame, control)`, within the rig's limits.
        motion: `(frame, 4, 4)`, or None.
        errors: of each frame.
    """

    controls: Tensor
    motion: Tensor | None
    errors: FrameErrors


@dataclass(frozen=True)
class Smoothness:
    """How a whole clip is solved at once.

    Attributes:
        smoothness: as in `solve_clip`.
        steps, mean_steps: as in `solve_clip`.
        blur: standard deviation, in frames, of what the frames' own answers are smoothed with to a start.
    """

    smoothness: float
    steps: int
    blur: float
    mean_steps: int = 0


def invert_clip(
    clip: Clip, inverter: WindowInverter, judge: FrameEvaluator, window: int, advance: Callable[[str, int], None]
) -> Inversion:
    """Invert each frame for itself, and judge it while it is at hand.

    Args:
        window: frames at a time: what bounds the memory.
        advance: told what is done, and how many frames are.
    """
    kept = _Kept(len(clip), inverter)
    for start, vertices in clip.batches(window):
        found = inverter.invert(vertices)
        judge.judge(found)
        kept.keep(start, found)
        advance("inverting", len(vertices))
    kept.check(clip)
    return kept.finished(interpolate_controls(kept.controls, kept.known, clip.frame_numbers), clip, judge)


def invert_smoothly(
    clip: Clip,
    inverter: WindowInverter,
    judge: FrameEvaluator,
    window: int,
    advance: Callable[[str, int], None],
    how: Smoothness,
) -> Inversion:
    """Invert all frames at once, so that curves are smooth: each frame for itself first, then all in mesh coordinates.

    The clip is read twice. Between, its mesh coordinates are kept, a fortieth of it for the default face.
    """
    solving = inverter.solving
    if not isinstance(solving, SolverEstimator):
        raise TypeError("a whole clip is for solvers")
    kept, size = _Kept(len(clip), inverter), solving.space.size
    coordinates, done = torch.full((len(clip), size), torch.nan), torch.zeros(len(clip), dtype=torch.bool)
    for first, vertices in clip.batches(window):
        found = inverter.invert(vertices)
        kept.keep(first, found)
        rows = slice(first, first + len(vertices))
        coordinates[rows] = torch.where(found.present[:, None], solving.space.encode(found.complete), torch.nan)
        done[rows] = solving.settled(found.complete, found.controls)  # before smoothness has its say
        advance("each frame", len(vertices))
    kept.check(clip)
    start = Solution.at_neutral(solving.objective, len(clip))
    start.units, start.skipped = solving.units(kept.controls), ~kept.known
    advance("the whole clip", 0)
    begin = smoothed(start, how.blur, clip.frame_numbers)
    smooth = solve_clip(
        solving.objective, coordinates, begin, how.smoothness, how.steps, how.mean_steps, numbers=clip.frame_numbers
    )
    controls = solving.controls(smooth)
    for first, vertices in clip.batches(window):
        rows = slice(first, first + len(vertices))
        found = _placed(vertices, controls[rows], inverter, kept.known[rows])
        judge.judge(found, done[rows])
        kept.keep(first, found)
        advance("judging", len(vertices))
    return kept.finished(controls, clip, judge)


def _placed(vertices: Tensor, controls: Tensor, inverter: WindowInverter, known: Tensor) -> Found:
    """Frames with controls that are settled, and the rigid motion that fits these best."""
    motion = None
    if inverter.anchors is not None:
        anchors = inverter.anchors.for_window(torch.isfinite(vertices[known]).all(dim=2))
        motion = fit_rigid(anchors.mesh(controls), vertices[:, anchors.some], anchors.weights)
    return inverter.placed(vertices, controls, motion, known)


class _Kept:
    """What stays of each frame; made once, so that windows come and go without leaving memory full of holes."""

    def __init__(self, frames: int, inverter: WindowInverter) -> None:
        self.controls = torch.zeros(frames, len(inverter.rig.controls), dtype=inverter.rig.dtype)
        self.motion = None if inverter.anchors is None else torch.zeros(frames, 4, 4, dtype=inverter.rig.dtype)
        self.known = torch.zeros(frames, dtype=torch.bool)

    def keep(self, first: int, found: Found) -> None:
        """Keep the frames of a window that starts at `first`."""
        rows = slice(first, first + len(found.controls))
        self.controls[rows], self.known[rows] = found.controls, found.present
        if self.motion is not None:
            self.motion[rows] = found.motion

    def check(self, clip: Clip) -> None:
        if not bool(self.known.any()):
            raise InputError(f"{clip.sequence.path}: no frame has enough known vertices: there is nothing to invert")

    def finished(self, controls: Tensor, clip: Clip, judge: FrameEvaluator) -> Inversion:
        motion = None if self.motion is None else interpolate_motion(self.motion, self.known, clip.frame_numbers)
        rig = judge.true_rig
        return Inversion(controls.clamp(rig.lower, rig.upper), motion, judge.errors(clip.frame_numbers))
