"""Frame times of a USD stage, from its authored rates and its time samples.

USD defines the clock: `timeCodesPerSecond`, else `framesPerSecond`, else 24. It does not define frames: here these are whole
time codes where the clock counts frames, and follow `framesPerSecond` or the samples where it counts seconds or ticks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MOST_FRAMES = 10_000_000
FALLBACK = 24.0  # USD's default of both rates
FRAME_RATES = (10.0, 240.0)  # range of clocks that count frames; others count seconds, milliseconds or ticks
SLOWEST = 5.0  # least rate of regular samples that are frames, not keys
MOST_BLUR = 16  # most samples per frame for motion blur
COVERED = 0.9  # fraction of frames that need a sample where others lie in between
NEAR = 1e-3  # tolerance in frames
JITTER = 0.15  # tolerance in frames for irregular samples
COMMON_RATES = (15.0, 24_000 / 1001, 24.0, 25.0, 30_000 / 1001, 30.0, 48.0, 50.0, 60_000 / 1001, 60.0, 90.0, 100.0, 120.0)
SAME_RATE = 0.01  # tolerance in time codes
DRIFT = 0.1  # greatest drift in frames between a measured and a common rate


class UnusableStageError(Exception):
    """A stage cannot be read; the message is for the user, without the file's name.

    Args:
        meshes: name, vertices and frames of each, where it is not clear which is meant; one frame: it never moves.
    """

    are_scans = False

    def __init__(self, message: str, meshes: Sequence[tuple[str, int, int]] = ()) -> None:
        super().__init__(message)
        self.meshes = meshes


class UnusableAsClipError(UnusableStageError):
    """A stage cannot be read as a clip of one mesh, and can as a clip of scans."""

    are_scans = True


@dataclass(frozen=True)
class StageClock:
    """Time metadata of a stage, None where not authored.

    Attributes:
        time_codes_per_second, frames_per_second: the rates.
        start, end: time codes; both or neither.
        requested: frame rate requested by the user.
    """

    time_codes_per_second: float | None = None
    frames_per_second: float | None = None
    start: float | None = None
    end: float | None = None
    requested: float | None = None

    def rate(self, notes: list[str]) -> tuple[float, str]:
        """Time codes per second, and their source.

        Raises:
            UnusableStageError: the authored rate is invalid, and the user requested none.
        """
        named = {"timeCodesPerSecond": self.time_codes_per_second, "framesPerSecond": self.frames_per_second}
        for name, rate in named.items():
            if rate is None:
                continue
            if _is_rate(rate):
                return float(rate), name
            if self.requested is None:
                raise UnusableStageError(f"{name} is {rate:g}, expected a number above 0: give the rate with reading.fps=...")
            notes.append(f"{name} is {rate:g}, which is no rate: only reading.fps counts.")
            return FALLBACK, "reading.fps"
        notes.append(
            "The stage authors neither timeCodesPerSecond nor framesPerSecond: 24 time codes a second, as USD defines for it "
            "(reading.fps=... gives another rate)."
        )
        return FALLBACK, "USD's fallback of 24 time codes a second"


@dataclass(frozen=True)
class Grid:
    """Frame `first + n` at time code `origin + step * n`.

    Attributes:
        slack: tolerance of samples, as a fraction of a step.
    """

    step: float
    origin: float = 0.0
    first: int = 0
    slack: float = NEAR


def grid_of(samples: np.ndarray, rate: float, clock: StageClock, notes: list[str]) -> Grid:
    """The grid of frames, from the authored rates and the samples.

    Args:
        samples: two time codes or more, ascending.
        rate: time codes per second.
        clock: the stage's metadata.
        notes: receives notes on guesses and contradictions.
    """
    authored = clock.frames_per_second if clock.time_codes_per_second is not None else None
    authored = authored if authored is not None and _is_rate(authored) else None
    whole = 1.0 if FRAME_RATES[0] <= rate <= FRAME_RATES[1] else None
    spaced = rate / authored if authored else None
    if whole and spaced and abs(spaced - whole) < SAME_RATE:  # 24 and 23.976 are both names of one clock
        spaced = None
    steps = sorted({step for step in (whole, spaced) if step}, reverse=True)
    fitting = [step for step in steps if is_on(samples, step)]
    requested = rate / clock.requested if clock.requested else None
    if requested and not fitting and is_on(samples, requested):
        return Grid(requested)
    fitting = fitting or [step for step in steps if _covers(samples, step)]
    if fitting:
        _note_contradiction(rate, authored, fitting[0], notes)
        return Grid(fitting[0])
    regular = _regular(samples, rate, [known for known in (rate, authored) if known])
    if regular and not any(abs(step / regular.step - n) < NEAR * n for step in steps for n in range(2, MOST_BLUR + 1)):
        _note_spacing(samples, rate, regular, notes)
        return regular
    if steps:
        return Grid(spaced or steps[0])
    if requested:
        return Grid(requested)
    notes.append(
        f"{rate:g} time codes make a second, the samples stand in no regular grid, and framesPerSecond is not authored: "
        f"{FALLBACK:g} frames a second were taken, USD's fallback (reading.fps=... gives another rate)."
    )
    return Grid(rate / FALLBACK)


def is_on(samples: np.ndarray, step: float) -> bool:
    """Whether all samples are at whole steps."""
    return bool(_whole(samples / step).all())


def whole_numbers(frames: np.ndarray) -> np.ndarray:
    """Frame numbers as int64.

    Raises:
        UnusableStageError: they are too large to be any.
    """
    if not np.abs(frames).max() < 2**53:
        raise UnusableStageError(f"frame {frames[0]:g} cannot be meant: damaged; export it again")
    return frames.astype(np.int64)


def _is_rate(rate: float) -> bool:
    return bool(np.isfinite(rate)) and 0 < rate <= 1e6


def _note_contradiction(rate: float, authored: float | None, step: float, notes: list[str]) -> None:
    if authored and abs(step * authored / rate - 1) > NEAR:
        notes.append(
            f"timeCodesPerSecond is {rate:g} and framesPerSecond {authored:g}: {rate / step:g} frames a second were taken, "
            f"since its samples stand at these."
        )


def _note_spacing(samples: np.ndarray, rate: float, regular: Grid, notes: list[str]) -> None:
    if abs(regular.step - 1) < NEAR:
        notes.append(f"Its samples stand beside the whole time codes: frame {regular.first} is time code {samples[0]:.6g}.")
        return
    notes.append(
        f"Its samples stand {regular.step:.6g} time codes apart, and {rate:g} time codes make a second: "
        f"{rate / regular.step:.6g} frames a second, one for each sample (reading.fps=... gives another rate)."
    )


def _whole(index: np.ndarray) -> np.ndarray:
    """Mask of whole numbers, within the precision of float32 seconds."""
    return np.abs(index - np.round(index)) <= NEAR + 1e-7 * np.abs(index)


def _covers(samples: np.ndarray, step: float) -> bool:
    """Whether nearly all frames of a grid have a sample, so that the other samples are for motion blur."""
    index = samples / step
    on = np.unique(np.round(index)[_whole(index)])
    frames = np.floor(index[-1] + NEAR) - np.ceil(index[0] - NEAR) + 1
    return len(on) >= max(2, COVERED * frames) and len(samples) <= MOST_BLUR * frames


def _regular(samples: np.ndarray, rate: float, known: list[float]) -> Grid | None:
    """The grid of evenly spaced samples, with gaps and jitter allowed."""
    if len(samples) < 4:
        return None
    gaps = np.diff(samples)
    steps = np.maximum(np.round(gaps / np.median(gaps)), 1)
    index = np.concatenate([[0.0], np.cumsum(steps)])
    step, origin = np.polyfit(index, samples - samples[0], 1)
    if step <= 0 or rate / step < SLOWEST or np.abs(samples - samples[0] - origin - step * index).max() > JITTER * step:
        return None
    for candidates in (known, COMMON_RATES):
        nearest = min(candidates, key=lambda common: abs(np.log(common * step / rate)))
        if abs(rate / nearest / step - 1) * index[-1] < DRIFT:
            step = rate / nearest
            break
    first = whole_numbers(np.floor((samples[:1] + origin) / step + JITTER))[0]
    return Grid(step, samples[0] + origin, int(first), JITTER)
