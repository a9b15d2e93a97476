"""Frame numbers and rate of samples from their times in a file: seconds, or other units where seconds are implausible."""

from typing import NamedTuple

import numpy as np

from riginv.clips.frame_rate import RATES
from riginv.clips.units import DEFAULT_FPS

NEAR = 1e-4  # relative difference within which a common rate is taken; more where the times are coarser
COARSEST = 0.01  # largest such difference
EVEN = 0.05  # fraction of a step by which times may miss their frames
ROUNDED = (2, 3, 4)  # decimals that texts round seconds to
MIN_FPS, MAX_FPS = 5.0, 1000.0  # plausible sampling rates
MAX_FRAME = 10_000_000  # largest plausible frame number
MAX_FRAME_STEP = 8.0  # largest step of times in frames; larger ones are in milliseconds
SMALLER_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}


class FrameTimes(NamedTuple):
    """Frame numbers and frame rate of the samples of a clip.

    Attributes:
        numbers: frame numbers `(sample,)`, rising.
        fps: frames per second; None where the file does not give it.
        rate_source: where that comes from; empty with None.
        notes: sentences: what was guessed, or is contradictory.
    """

    numbers: np.ndarray
    fps: float | None = None
    rate_source: str = ""
    notes: tuple[str, ...] = ()


def frames_at_step(start: float, step: float, count: int) -> FrameTimes:
    """Samples every `step` frames from frame `start`, of a file that does not give its rate."""
    notes = []
    step = float(f"{step:.6g}")  # undoes the rounding to 32 bits
    if not (np.isfinite(step) and 1 / MAX_FRAME < step < MAX_FRAME):
        notes.append(f"A sample every {step:g} frames makes no sense: one at each frame was taken.")
        step = 1.0
    if not (np.isfinite(start) and abs(start) < MAX_FRAME):
        notes.append(f"A first sample at frame {start:g} makes no sense: frame 0 was taken.")
        start = 0.0
    if step == round(step) and start == round(start):
        return FrameTimes(round(start) + round(step) * np.arange(count), notes=tuple(notes))
    first = round(start / step)
    if abs(first * step - start) > EVEN * step:
        notes.append(f"It starts at frame {start:g}, between two of its samples: it is counted from frame {first}.")
    if step == 1:
        return FrameTimes(first + np.arange(count), notes=tuple(notes))
    fps = DEFAULT_FPS / step
    notes.append(
        f"It has a sample every {step:g} frames: each sample is a frame of the clip, {fps:g} a second, because {DEFAULT_FPS:g} "
        f"frames a second were taken (reading.fps=N: N samples a second)."
    )
    source = f"a sample every {step:g} frames, at {DEFAULT_FPS:g} frames a second"
    return FrameTimes(first + np.arange(count), fps, source, tuple(notes))


def frames_from_times(times: np.ndarray, source: str) -> FrameTimes:
    """Samples at times `(sample,)` in seconds, or in frames or smaller units where seconds would be implausible.

    Args:
        source: the file's name for the times, for notes.
    """
    count = len(times)
    in_order = FrameTimes(np.arange(count))
    if count < 2:
        return in_order
    resolution = float(np.spacing(np.abs(times).max())) if np.isfinite(times).all() else np.inf
    times = times.astype(np.float64)
    for digits in ROUNDED:
        if np.isfinite(resolution) and (np.abs(times - np.round(times, digits)) < 1e-9).all():
            resolution = max(resolution, 0.5 * 10.0**-digits)
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.diff(times)
    if not np.isfinite(resolution) or not (steps > 0).all():
        fault = "are not all numbers" if not np.isfinite(resolution) else "do not rise from frame to frame"
        return in_order._replace(notes=(f"Its {source} {fault}: the frames were taken one after the other.",))
    step = float(np.median(steps))
    if step >= MAX_FRAME_STEP and (times == np.round(times)).all():
        resolution = max(resolution, 0.5)  # whole milliseconds
    bases = (step, float(steps.min()))
    multiples = next((found for base in bases if (found := _multiples(steps, base, resolution)) is not None), None)
    if multiples is None:
        return _uneven(times, steps, source)
    step = float((times[-1] - times[0]) / multiples.sum())
    skipped = np.concatenate([[0], np.cumsum(multiples)]).astype(np.int64)
    if 1 / MIN_FPS < step < MAX_FRAME_STEP:
        return _in_frames(times, step, skipped, source)
    unit = next((name for name, size in SMALLER_UNITS.items() if MIN_FPS <= 1 / (size * step) <= MAX_FPS), "")
    if step < MAX_FRAME_STEP or not unit:
        return _in_seconds(times, step, skipped, resolution, source)
    size = SMALLER_UNITS[unit]
    frame_times = _in_seconds(times * size, step * size, skipped, resolution * size, source)
    note = f"Its {source} are in {unit}: seconds would be {1 / step:.3g} frames a second (reading.fps=...)."
    return frame_times._replace(notes=(note, *frame_times.notes))


def _multiples(steps: np.ndarray, base: float, resolution: float) -> np.ndarray | None:
    """Each step as a multiple of `base`; None where one is no multiple."""
    multiples = np.maximum(np.round(steps / base), 1)
    base = float(steps.sum() / multiples.sum())
    error = np.abs(steps / base - multiples)
    return multiples if (error <= EVEN + 2 * resolution / base).all() and multiples.sum() < MAX_FRAME else None


def _in_seconds(times: np.ndarray, step: float, skipped: np.ndarray, resolution: float, source: str) -> FrameTimes:
    """Samples whose times are seconds, at `skipped` steps of `step` after the first."""
    if not MIN_FPS <= 1 / step <= MAX_FPS:
        note = f"Its {source} are {step:.3g} apart, {1 / step:.3g} frames a second, which is implausible: ignored."
        return FrameTimes(np.arange(len(times)), notes=(note,))
    fps = common_rate_at(1 / step, 2 * resolution / float(times[-1] - times[0]), float(times[0]))
    first = round(float(times[0]) * fps)
    numbers = (first if abs(first) < MAX_FRAME else 0) + skipped
    return FrameTimes(numbers, fps, f"its {source}", _missing(skipped, source))


def common_rate_at(rate: float, coarse: float = 0.0, time: float = 0.0) -> float:
    """The common rate near a measured one, else the measured one.

    Args:
        coarse: relative error of the measured rate.
        time: of a frame, seconds: of several common rates, one is preferred that gives an integer frame number there; of
            several of these, which the times are too coarse to tell apart, a whole one.
    """
    near = [float(common) for common in RATES if abs(common / rate - 1) <= min(max(NEAR, coarse), COARSEST)]

    def misfit(common: float) -> tuple[bool, bool, float]:
        return abs(time * common - round(time * common)) > EVEN, common != round(common), abs(common - rate)

    return min(near, key=misfit, default=round(rate, 3))


def _uneven(times: np.ndarray, steps: np.ndarray, source: str) -> FrameTimes:
    """Consecutive samples at their mean rate, by least squares."""
    fps = 1 / float(np.polyfit(np.arange(len(times)), times - times[0], 1)[0])
    note = f"Its {source} are uneven, {steps.min():.3g} to {steps.max():.3g} apart: the frames were taken one after the other"
    numbers = np.arange(len(times))
    if not MIN_FPS <= fps <= MAX_FPS:
        return FrameTimes(numbers, notes=(f"{note}.",))
    fps = common_rate_at(fps)
    return FrameTimes(
        numbers, fps, f"its {source}, in all", (f"{note}, {fps:g} a second as they are in all (reading.fps=...).",)
    )


def _in_frames(times: np.ndarray, step: float, skipped: np.ndarray, source: str) -> FrameTimes:
    """Samples whose times are frames."""
    found = frames_at_step(float(times[0]), round(step, 6), len(times))
    stride = int(found.numbers[1] - found.numbers[0])
    first = ", ".join(f"{time:g}" for time in times[:3])
    rate = f"{found.fps:g} samples a second" if found.fps else f"{DEFAULT_FPS:g} frames a second"
    note = (
        f"Its {source} ({first}, ...) are frames and not seconds, which would be {1 / step:.3g} frames a second: {rate} were "
        f"taken (reading.fps=...)."
    )
    kept = tuple(note for note in found.notes if not note.startswith("It has a sample"))
    return found._replace(numbers=found.numbers[0] + stride * skipped, notes=(note, *kept, *_missing(skipped, source)))


def _missing(skipped: np.ndarray, source: str) -> tuple[str, ...]:
    missing = int(skipped[-1] - skipped[0]) + 1 - len(skipped)
    return (f"By its {source} {missing} frames are missing: the frame numbers have gaps there.",) if missing else ()
