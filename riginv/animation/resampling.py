"""Resampling of animations to another frame rate, and filling of gaps."""

from dataclasses import replace

import numpy as np
import scipy
import torch
from torch import Tensor

from riginv.animation.animation import Animation
from riginv.errors import InputError

MAX_FRAMES = 10_000_000


def resampled(animation: Animation, fps: float) -> Animation:
    """An animation at another frame rate; it starts at the same time and ends no later.

    Controls are interpolated by monotone cubics (Fritsch and Carlson 1980), which stay within the limits; rotations along the
    shortest arc. Keys are lost: reduce keys afterwards.

    Raises:
        InputError: fps is not a finite number above 0, or makes more than ten million frames.
    """
    if not 0 < fps < float("inf"):
        raise InputError(f"fps is {fps}, expected a finite number above 0")
    seconds = animation.seconds.numpy()
    count = seconds[-1] * fps + 1 + 1e-6
    if count > MAX_FRAMES:
        raise InputError(f"fps={fps:g} makes {count:.0f} frames of a clip of {seconds[-1]:.1f} s, the most is {MAX_FRAMES}")
    first = round(int(animation.frame_numbers[0]) * fps / animation.fps)
    return _at(animation, np.arange(int(count)) / fps, torch.arange(first, first + int(count)), fps)


def fill_gaps(animation: Animation) -> Animation:
    """The animation with every frame from its first to its last, for formats that cannot omit frames."""
    first, last = int(animation.frame_numbers[0]), int(animation.frame_numbers[-1])
    if last - first + 1 == len(animation):
        return animation
    if last - first >= MAX_FRAMES:
        raise InputError(f"frames {first} to {last}: more than {MAX_FRAMES} would be needed to fill the gaps; renumber them")
    numbers = torch.arange(first, last + 1)
    return _at(animation, (numbers - first).double().numpy() / animation.fps, numbers, animation.fps)


def _at(animation: Animation, times: np.ndarray, numbers: Tensor, fps: float) -> Animation:
    seconds, controls = animation.seconds.numpy(), animation.controls.detach().cpu()
    times = np.minimum(times, seconds[-1])
    if len(seconds) == 1:
        values, motion = controls.repeat(len(times), 1), animation.motion
    else:
        from scipy.interpolate import PchipInterpolator  # takes half a second

        between = PchipInterpolator(seconds, controls.double().numpy(), axis=0)(times)
        lower, upper = animation.rig.lower.cpu(), animation.rig.upper.cpu()
        values = torch.tensor(between).to(controls).clamp(lower, upper)  # rounding may exceed a limit
        motion = None if animation.motion is None else _motion_at(seconds, animation.motion, times)
    return replace(animation, controls=values, fps=fps, frame_numbers=numbers, motion=motion, keys=None)


def _motion_at(seconds: np.ndarray, motion: Tensor, times: np.ndarray) -> Tensor:
    known = motion.detach().cpu().double().numpy()
    between = np.broadcast_to(np.eye(4), (len(times), 4, 4)).copy()
    rotations = scipy.spatial.transform.Rotation.from_matrix(known[:, :3, :3])
    between[:, :3, :3] = scipy.spatial.transform.Slerp(seconds, rotations)(times).as_matrix()
    between[:, :3, 3] = np.stack([np.interp(times, seconds, known[:, axis, 3]) for axis in range(3)], axis=1)
    return torch.tensor(between).to(motion)
