"""Frames of a USD stage: whole steps of its clock, over the time samples of the mesh and the stage's range."""

from dataclasses import dataclass

import numpy as np

from rigs.usd.stage_clock import (
    FALLBACK,
    FRAME_RATES,
    MOST_FRAMES,
    NEAR,
    Grid,
    StageClock,
    UnusableStageError,
    grid_of,
    is_on,
    whole_numbers,
)

SAME = 2e-7  # tolerance of equal time codes, absolute and relative


@dataclass(frozen=True)
class FrameGrid:
    """Frames.

    Attributes:
        numbers: `(frame,)`, ascending by one; time codes where these count frames.
        times: time code of each, `(frame,)`.
        fps: frames per second.
        source: of the frame rate.
        notes: sentences about guesses, contradictions, and what was ignored.
    """

    numbers: np.ndarray
    times: np.ndarray
    fps: float
    source: str
    notes: tuple[str, ...]


def frame_grid(samples: np.ndarray, clock: StageClock, held: bool = False) -> FrameGrid:
    """Frames from the first time sample to the last, extended to the stage's range.

    Args:
        samples: distinct time codes of everything that moves the mesh, `(sample,)`, ascending; none or one: a still frame.
        clock: the stage's metadata.
        held: whether frames without a sample hold the one before, instead of being interpolated.

    Raises:
        UnusableStageError: times or rates are damaged.
    """
    if len(samples) > MOST_FRAMES or not np.isfinite(samples).all():
        raise UnusableStageError(f"{len(samples)} time samples, not all of them numbers: damaged; export it again")
    notes: list[str] = []
    samples = _distinct(samples)
    rate, source = clock.rate(notes)
    stage_range = _range(samples, clock, rate, notes)
    if len(samples) < 2:
        start, end = stage_range or (0.0, 0.0)
        time = float(samples[0]) if len(samples) else start
        though = f", though the stage says time codes {start:g} to {end:g}" if end > start else ""
        notes.append(f"Nothing moves the mesh: one still frame was read{though}.")
        return FrameGrid(whole_numbers(np.floor([time])), np.array([time]), rate, source, tuple(notes))
    grid = grid_of(samples, rate, clock, notes)
    start, end = stage_range or (samples[0], samples[-1])
    low, high = min(samples[0], start), max(samples[-1], end)
    numbers, times = _frames(grid, samples, low, high)
    _note_samples(samples, times, grid, rate, held, notes)
    return FrameGrid(numbers, times, rate / grid.step, _source(grid, rate, source, clock), tuple(notes))


def _distinct(samples: np.ndarray) -> np.ndarray:
    """Samples without those equal to the one before, up to rounding."""
    return samples[np.diff(samples, prepend=-np.inf) > SAME * np.maximum(np.abs(samples), 1)]


def _range(samples: np.ndarray, clock: StageClock, rate: float, notes: list[str]) -> tuple[float, float] | None:
    """The stage's first and last time code, where they are plausible."""
    start, end = clock.start, clock.end
    if start is None or end is None:
        return None
    text = f"startTimeCode {start:g} and endTimeCode {end:g}"
    if not (np.isfinite([start, end]).all() and start <= end):
        notes.append(f"{text} are no range: they were passed over.")
        return None
    if len(samples) < 2:
        return start, end
    first, last = samples[0], samples[-1]
    if end < first or start > last:
        notes.append(f"{text} lie beside all its samples, which go from {first:g} to {last:g}: these were read.")
        return None
    frame = max(1.0, rate / FALLBACK)
    if first < start - frame or last > end + frame:
        notes.append(
            f"Its samples go from {first:g} to {last:g}, beyond {text}: all were read (frames.first and frames.last leave "
            f"frames out)."
        )
    if start < first - frame or end > last + frame:
        notes.append(
            f"Its samples go from {first:g} to {last:g}, the stage's range from {start:g} to {end:g}: USD holds the first and "
            f"the last sample beyond them."
        )
    return start, end


def _frames(grid: Grid, samples: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and times of a grid's frames between two time codes; times snap to samples at the frame."""
    first = np.ceil((low - grid.origin) / grid.step - grid.slack)
    last = np.floor((high - grid.origin) / grid.step + grid.slack)
    if not last - first < MOST_FRAMES:
        raise UnusableStageError(
            f"time codes {low:g} to {high:g} are more than {MOST_FRAMES:,} frames: damaged, or startTimeCode or endTimeCode is "
            f"wrong; export it again"
        )
    if last < first:  # less than a frame, and no whole time code in it
        first = last = np.floor((low - grid.origin) / grid.step)
    frames = np.arange(first, last + 1)
    times = grid.origin + grid.step * frames
    after = np.clip(np.searchsorted(samples, times), 1, len(samples) - 1)
    nearest = np.where(times - samples[after - 1] <= samples[after] - times, samples[after - 1], samples[after])
    at = np.abs(nearest - times) <= grid.slack * grid.step + 1e-7 * np.abs(times)
    times[at] = nearest[at]
    return whole_numbers(frames + grid.first), times


def _source(grid: Grid, rate: float, source: str, clock: StageClock) -> str:
    if abs(grid.step - 1) <= NEAR:
        return source
    for name, fps in (("framesPerSecond", clock.frames_per_second), ("reading.fps", clock.requested)):
        if fps and abs(rate / grid.step / fps - 1) < NEAR:
            return name
    return f"the spacing of its samples and {source}"


def _note_samples(samples: np.ndarray, times: np.ndarray, grid: Grid, rate: float, held: bool, notes: list[str]) -> None:
    """Add notes on samples between frames, and frames without samples."""
    passed_over = len(samples) - len(np.intersect1d(samples, times))
    if passed_over:
        finest = np.diff(samples).min()
        more = f"; reading.fps={rate / finest:.6g} reads them as frames" if is_on(samples, finest) else ""
        notes.append(
            f"{passed_over} of {len(samples)} samples lie between frames, as for motion blur, and were passed over{more}."
        )
    inside = times[(times >= samples[0]) & (times <= samples[-1])]
    interpolated = len(inside) - len(np.intersect1d(inside, samples))
    if interpolated:
        how = "they hold the one before" if held else "USD interpolates them"
        notes.append(f"{interpolated} of {len(times)} frames have no sample of their own: {how}.")
    if rate / grid.step > FRAME_RATES[1]:
        notes.append(f"{rate / grid.step:.6g} frames a second are many: reading.fps=... gives the rate, if the stage is wrong.")
