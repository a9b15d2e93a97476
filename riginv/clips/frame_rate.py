"""Frame rates: common ones, and the rate of rows whose times may have gaps, jitter, or be truncated to whole counts."""

import numpy as np

COUNTS = (24, 25, 30, 48, 50, 60, 90, 100, 120, 240, 1000)  # frames per second that timecodes count
RATES = (*COUNTS[:-1], *(count * 1000 / 1001 for count in (24, 30, 60, 120)), 10, 12, 15, 20)
SAME_RATE = 4e-4  # relative difference below which two rates are the same
NEAR_RATE = 0.01  # relative difference within which a common rate is tried
IN_STEP = 0.02  # frames of additional error with which a common rate is preferred to the measured one
FINER = 0.75  # of the median step: consecutive shorter steps belong to a higher rate
ENOUGH = 0.05  # fraction of the rows that a higher rate needs
FEW = 10  # frames: longer steps do not count in the mean
TRUNCATED = 0.1  # fraction of the steps that must be the shorter, and the longer, of two whole numbers for truncated times


def frames_per_second(time: np.ndarray, rate: float) -> float:
    """The frame rate of at least two rising times.

    Args:
        time: `(frame,)`, in counts.
        rate: counts per second.
    """
    truncated = _step_of_truncated(time, rate)
    return common_rate(rate / truncated) if truncated else _locked(time, rate, common_rate(rate / _step(time)))


def _step(time: np.ndarray) -> float:
    """The step between two rows, in counts."""
    change = np.diff(time)
    step = float(np.median(change))
    while True:
        fine = change < FINER * step
        fine[1:] &= fine[:-1]
        if np.count_nonzero(fine) < max(2, ENOUGH * len(change)):
            break
        step = float(np.median(change[fine]))
    steps = np.round(change / step)
    few = steps <= FEW
    return float(change[few].sum() / max(steps[few].sum(), 1))


def _step_of_truncated(time: np.ndarray, rate: float) -> float | None:
    """The step between rows whose times were truncated to whole counts, so that steps alternate between two; else None.

    It is that of a common rate from whose frames no row is a whole count away.
    """
    change = np.diff(time)
    step = float(np.median(change))
    near = change[change <= step + 1]
    if (
        (change % 1).any()
        or np.ptp(near) != 1
        or (near == near.max()).mean() < TRUNCATED
        or (near == near.min()).mean() < TRUNCATED
    ):
        return None
    spans = np.split(time, np.flatnonzero(change > step + 1) + 1)
    for common in sorted(RATES, key=lambda one: (one % 1 != 0, abs(rate / one - near.mean()))):
        away = [np.ptp(span - rate / common * np.arange(len(span))) for span in spans]
        if max(away) < 1 + 1e-6:
            return rate / common
    return None


def _locked(time: np.ndarray, rate: float, fps: float) -> float:
    """The common rate near `fps` that fits the rows from the first to the last; else `fps`."""

    def out_of_step(one: float) -> float:
        frames = (time - time[0]) * one / rate
        return float(np.median(np.abs(frames - np.round(frames))))

    near = [one for one in RATES if abs(one - fps) < NEAR_RATE * one]
    best = min(near, key=lambda one: (round(out_of_step(one), 3), abs(one - fps)), default=fps)
    return float(best) if out_of_step(best) <= out_of_step(fps) + IN_STEP else fps


def common_rate(fps: float) -> float:
    """The common rate within `SAME_RATE` of a rate, else the rate."""
    nearest = min(RATES, key=lambda rate: abs(rate - fps))
    return float(nearest) if abs(nearest - fps) < SAME_RATE * nearest else round(fps, 3)
