"""Frame times of an animation, from its first key to its last."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from riginv.errors import InputError
from rigs.gltf.frame_rate import EXACT, KeyTimes, Rate

MOST_FRAMES = 1_000_000
SAME = 1e-3  # relative tolerance within which the user's rate is that of the keys


@dataclass(frozen=True)
class Timing:
    """The frames of an animation.

    Attributes:
        rate: frame rate.
        origin: time of frame 0, seconds.
        first, count: number of the first frame, and number of frames.
    """

    rate: Rate
    origin: float
    first: int
    count: int

    def seconds(self) -> np.ndarray:
        """Time of each frame, `(frame,)`."""
        return self._time(self.first + np.arange(self.count, dtype=np.float64))

    def on_frames(self, times: np.ndarray) -> np.ndarray:
        """Key times, snapped to the exact time of a frame where float32 rounding put them just beside it."""
        frames = (times - self.origin) * self.rate.fps
        whole = np.round(frames)
        return np.where(np.abs(frames - whole) <= self.rate.tolerance, self._time(whole), times)

    def _time(self, frames: np.ndarray) -> np.ndarray:
        return self.origin + frames / self.rate.fps


def timing_of(path: str, keys: Sequence[np.ndarray], fps: float | None) -> Timing:
    """Frame times of an animation.

    Args:
        path: for messages.
        keys: key times of each channel, `(key,)`, seconds.
        fps: requested frame rate; None: estimated from the times.

    Raises:
        InputError: there would be too many frames, or times are so late that float32 cannot resolve frames.
    """
    evidence = KeyTimes(np.concatenate(keys))
    first, last = min(float(times[0]) for times in keys), max(float(times[-1]) for times in keys)
    if evidence.too_coarse():
        raise InputError(
            f"{path}: its keys stand at {first:.6g} s and later, where glTF's times are {evidence.resolution:.3g} s apart, "
            f"expected a small part of a frame: export it again with an animation that starts near 0 s"
        )
    rate = evidence.rate()
    if fps:
        same = abs(fps / rate.fps - 1) < SAME
        rate = Rate(fps, "reading.fps", rate.tolerance) if same else Rate(fps, "reading.fps", evidence.exact(fps))
    if not (last - first) * rate.fps < MOST_FRAMES or not max(abs(first), abs(last)) * rate.fps < 2**53:
        raise InputError(
            f"{path}: {last - first:.3g} s from {first:.3g} s on at {rate.fps:g} frames a second are more than can be meant: "
            f"the file is damaged, or reading.fps is wrong"
        )
    origin = evidence.phase(rate.fps, rate.tolerance) / rate.fps
    near = rate.tolerance + EXACT
    start = math.floor((first - origin) * rate.fps + near)
    stop = math.ceil((last - origin) * rate.fps - near)
    return Timing(replace(rate, fps=float(rate.fps)), origin, start, max(stop - start, 0) + 1)
