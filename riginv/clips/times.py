"""Frame numbers and rate of samples whose times stand in a file: in seconds, or in what is meant where seconds cannot be."""

from typing import NamedTuple

import numpy as np

from riginv.clips.units import DEFAULT_FPS

USUAL = (
    12.0,
    15.0,
    24.0,
    25.0,
    30.0,
    48.0,
    50.0,
    60.0,
    90.0,
    100.0,
    120.0,
    240.0,
    *(n * 1000 / 1001 for n in (24, 30, 60, 120)),
)
NEAR = 1e-4  # of a usual rate, within which it is meant; times may be coarser than that
COARSEST = 0.01  # part of a rate that times may be off, for a usual one to be looked for
EVEN = 0.05  # of a step, by which times may miss their frames
LEAST, MOST = 5.0, 1000.0  # samples a second that meshes are recorded at
FARTHEST = 10_000_000  # frame that can be meant
MOST_FRAMES_APART = 8.0  # of two samples whose times are in frames: beyond that they are in milliseconds
SMALLER_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}


class FrameTimes(NamedTuple):
    """When the samples of a clip are.

    Attributes:
        numbers: of their frames, `(sample,)`, rising.
        fps: frames a second; None where the file does not tell.
        rate_source: where that comes from; empty with None.
        notes: whole sentences: what was guessed, or contradicts itself.
    """

    numbers: np.ndarray
    fps: float | None = None
    rate_source: str = ""
    notes: tuple[str, ...] = ()


def frames_at_step(start: float, step: float, count: int) -> FrameTimes:
    """Samples every `step` frames from frame `start` on, of a file that does not say its rate."""
    notes = []
    step = float(f"{step:.6g}")  # as it was before it became a single float
    if not (np.isfinite(step) and 1 / FARTHEST < step < FARTHEST):
        notes.append(f"A sample every {step:g} frames makes no sense: one at each frame was taken.")
        step = 1.0
    if not (np.isfinite(start) and abs(start) < FARTHEST):
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
    """Samples at times `(sample,)`: in seconds, or in frames or smaller units where a clip in seconds would be too slow.

    Args:
        source: what the file calls them.
    """
    count = len(times)
    in_order = FrameTimes(np.arange(count))
    if count < 2:
        return in_order
    resolution = float(np.spacing(np.abs(times).max())) if np.isfinite(times).all() else np.inf
    times = times.astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.diff(times)
    if not np.isfinite(resolution) or not (steps > 0).all():
        what = "are not all numbers" if not np.isfinite(resolution) else "do not rise from frame to frame"
        return in_order._replace(notes=(f"Its {source} {what}: the frames were taken one after the other.",))
    step = float(np.median(steps))
    if step >= MOST_FRAMES_APART and (times == np.round(times)).all():
        resolution = max(resolution, 0.5)  # whole milliseconds
    apart = next(
        (found for base in (step, float(steps.min())) if (found := _multiples(steps, base, resolution)) is not None), None
    )
    if apart is None:
        return _uneven(times, steps, source)
    step = float((times[-1] - times[0]) / apart.sum())
    skipped = np.concatenate([[0], np.cumsum(apart)]).astype(np.int64)
    if 1 / LEAST < step < MOST_FRAMES_APART:
        return _in_frames(times, step, skipped, source)
    unit = next((name for name, size in SMALLER_UNITS.items() if LEAST <= 1 / (size * step) <= MOST), "")
    if step < MOST_FRAMES_APART or not unit:
        return _in_seconds(times, step, skipped, resolution, source)
    size = SMALLER_UNITS[unit]
    found = _in_seconds(times * size, step * size, skipped, resolution * size, source)
    said = f"Its {source} are in {unit}: seconds would be {1 / step:.3g} frames a second (reading.fps=...)."
    return found._replace(notes=(said, *found.notes))


def _multiples(steps: np.ndarray, base: float, resolution: float) -> np.ndarray | None:
    """How many times a step each of some steps is; None where one is no multiple of it."""
    apart = np.maximum(np.round(steps / base), 1)
    base = float(steps.sum() / apart.sum())
    off = np.abs(steps / base - apart)
    return apart if (off <= EVEN + 2 * resolution / base).all() and apart.sum() < FARTHEST else None


def _in_seconds(times: np.ndarray, step: float, skipped: np.ndarray, resolution: float, source: str) -> FrameTimes:
    """Samples whose times are seconds, `step` apart and `skipped` steps behind the first."""
    if not LEAST <= 1 / step <= MOST:
        note = f"Its {source} are {step:.3g} apart, {1 / step:.3g} frames a second, which cannot be meant: passed over."
        return FrameTimes(np.arange(len(times)), notes=(note,))
    fps = usual_rate(1 / step, 2 * resolution / float(times[-1] - times[0]), float(times[0]))
    first = round(float(times[0]) * fps)
    numbers = (first if abs(first) < FARTHEST else 0) + skipped
    return FrameTimes(numbers, fps, f"its {source}", _missing(skipped, source))


def usual_rate(rate: float, coarse: float = 0.0, time: float = 0.0) -> float:
    """The usual rate that is meant by one that was measured, where one is near.

    Args:
        coarse: what part of itself the measured one may be off.
        time: of a frame, seconds: of several rates that are near, the one is meant that counts a whole number there.
    """
    near = [usual for usual in USUAL if abs(usual / rate - 1) <= min(max(NEAR, coarse), COARSEST)]
    return min(
        near, key=lambda usual: (abs(time * usual - round(time * usual)) > EVEN, abs(usual - rate)), default=round(rate, 3)
    )


def _uneven(times: np.ndarray, steps: np.ndarray, source: str) -> FrameTimes:
    """Samples one after the other, at the rate that they have in all, by least squares."""
    fps = 1 / float(np.polyfit(np.arange(len(times)), times - times[0], 1)[0])
    said = f"Its {source} are uneven, {steps.min():.3g} to {steps.max():.3g} apart: the frames were taken one after the other"
    numbers = np.arange(len(times))
    if not LEAST <= fps <= MOST:
        return FrameTimes(numbers, notes=(f"{said}.",))
    fps = usual_rate(fps)
    return FrameTimes(
        numbers, fps, f"its {source}, in all", (f"{said}, {fps:g} a second as they are in all (reading.fps=...).",)
    )


def _in_frames(times: np.ndarray, step: float, skipped: np.ndarray, source: str) -> FrameTimes:
    """Samples whose times are frames."""
    found = frames_at_step(float(times[0]), round(step, 6), len(times))
    stride = int(found.numbers[1] - found.numbers[0])
    first = ", ".join(f"{time:g}" for time in times[:3])
    said = f"{found.fps:g} samples a second" if found.fps else f"{DEFAULT_FPS:g} frames a second"
    note = (
        f"Its {source} ({first}, ...) are frames and not seconds, which would be {1 / step:.3g} frames a second: {said} were "
        f"taken (reading.fps=...)."
    )
    kept = tuple(note for note in found.notes if not note.startswith("It has a sample"))
    return found._replace(numbers=found.numbers[0] + stride * skipped, notes=(note, *kept, *_missing(skipped, source)))


def _missing(skipped: np.ndarray, source: str) -> tuple[str, ...]:
    missing = int(skipped[-1] - skipped[0]) + 1 - len(skipped)
    return (f"By its {source} {missing} frames are missing: the frame numbers have gaps there.",) if missing else ()
