"""A clip from end to end, window by window; only controls, motion and errors are kept of each frame."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.curves.animation import FrameErrors
from riginv.errors import InputError
from riginv.inversion.bridging import bridged, bridged_motion
from riginv.inversion.frame_judge import FrameJudge
from riginv.inversion.rigid import fit_rigid
from riginv.inversion.solving import BySolver
from riginv.inversion.window import Found, WindowInverter
from riginv.solvers.clip import solve_clip
from riginv.solvers.levenberg_marquardt import Solution
from riginv.solvers.smoothing import smoothed


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
        steps: Gauss-Newton steps.
        blur: standard deviation, in frames, of what the frames' own answers are smoothed with to a start.
    """

    smoothness: float
    steps: int
    blur: float


def invert_clip(
    clip: Clip, inverter: WindowInverter, judge: FrameJudge, window: int, advance: Callable[[str, int], None]
) -> Inversion:
    """Invert each frame for itself, and judge it while it is at hand.

    Args:
        window: frames at a time: what bounds the memory.
        advance: told what is done, and how many frames are.
    """
    controls, motions, present = [], [], []
    for _, vertices in clip.pieces(window):
        found = inverter.invert(vertices)
        judge.judge(found)
        controls.append(found.controls)
        motions.append(found.motion)
        present.append(found.present)
        advance("inverting", len(vertices))
    return _finished(clip, torch.cat(controls), motions, torch.cat(present), judge)


def invert_smoothly(
    clip: Clip,
    inverter: WindowInverter,
    judge: FrameJudge,
    window: int,
    advance: Callable[[str, int], None],
    how: Smoothness,
) -> Inversion:
    """Invert all frames at once, so that curves are smooth: each frame for itself first, then all in mesh coordinates.

    The clip is read twice. Between, its mesh coordinates are kept, a fortieth of it for the default face.
    """
    solving = inverter.solving
    if not isinstance(solving, BySolver):
        raise TypeError("a whole clip is for solvers")
    coordinates, units, motions, present, settled = [], [], [], [], []
    for _, vertices in clip.pieces(window):
        found = inverter.invert(vertices)
        seen = found.present[:, None]
        coordinates.append(torch.where(seen, solving.space.encode(found.complete), torch.nan))
        units.append(solving.units(found.controls))
        settled.append(solving.settled(found.complete, found.controls))  # before smoothness has its say
        motions.append(found.motion)
        present.append(found.present)
        advance("each frame", len(vertices))
    known, done = torch.cat(present), torch.cat(settled)
    start = Solution.at_neutral(solving.objective, len(known))
    start.units, start.skipped = torch.cat(units), ~known
    advance("the whole clip", 0)
    smooth = solve_clip(solving.objective, torch.cat(coordinates), smoothed(start, how.blur), how.smoothness, how.steps)
    controls = solving.controls(smooth)
    for first, vertices in clip.pieces(window):
        rows = slice(first, first + len(vertices))
        judge.judge(_placed(vertices, controls[rows], inverter, known[rows]), done[rows])
        advance("judging", len(vertices))
    return _finished(clip, controls, motions, known, judge, bridge=False)


def _placed(vertices: Tensor, controls: Tensor, inverter: WindowInverter, known: Tensor) -> Found:
    """Frames with controls that are settled, and the rigid motion that fits these best."""
    motion = None
    if inverter.anchors is not None:
        anchors = inverter.anchors.for_window(torch.isfinite(vertices[known]).all(dim=2))
        motion = fit_rigid(anchors.mesh(controls), vertices[:, anchors.some], anchors.weights)
    return inverter.placed(vertices, controls, motion, known)


def _finished(
    clip: Clip, controls: Tensor, motions: list[Tensor | None], known: Tensor, judge: FrameJudge, bridge: bool = True
) -> Inversion:
    if not bool(known.any()):
        raise InputError(f"{clip.sequence.path}: no frame has enough known vertices: there is nothing to invert")
    motion = None if motions[0] is None else bridged_motion(torch.cat(motions), known)
    rig = judge.true_rig
    controls = (bridged(controls, known) if bridge else controls).clamp(rig.lower, rig.upper)
    return Inversion(controls, motion, judge.errors(clip.frame_numbers))
