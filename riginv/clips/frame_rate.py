"""Frames a second from the times of frames, some of which may be missing, shaken, or cut to whole counts."""

import numpy as np

COUNTS = (24, 25, 30, 48, 50, 60, 90, 100, 120, 240, 1000)  # frames that timecodes count in a second
RATES = (*COUNTS[:-1], *(count * 1000 / 1001 for count in (24, 30, 60, 120)), 10, 12, 15, 20)
SAME_RATE = 4e-4  # two rates nearer than that, as a share of them, are one
NEAR_RATE = 0.01  # of a usual rate, that rows may seem to be away from it
IN_STEP = 0.02  # frames that rows may be out of step more than at the rate that was measured
FINER = 0.75  # of the usual distance: rows nearer than that, one after the other, are of a finer rate
ENOUGH = 0.05  # of all rows, for a finer rate to be taken for one
FEW = 10  # frames from one row to the next, for the two to tell how far apart frames are
CUT = 0.1  # of all distances, at least, that are the shorter and the longer one of rows that were cut to whole counts


def frames_per_second(time: np.ndarray, rate: float) -> float:
    """The rate of frames at rising times `(frame,)`, at least two of them.

    Args:
        time: in counts.
        rate: how many counts are a second.
    """
    cut = _step_of_cut(time, rate)
    return usual_rate(rate / cut) if cut else _locked(time, rate, usual_rate(rate / _step(time)))


def _step(time: np.ndarray) -> float:
    """The usual distance of two rows, in counts."""
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


def _step_of_cut(time: np.ndarray, rate: float) -> float | None:
    """The distance of rows whose times were cut to whole counts, and so lie a count nearer or farther in turns; None: not so.

    Then it is that of a usual rate, from whose frames no row is a whole count away.
    """
    change = np.diff(time)
    step = float(np.median(change))
    near = change[change <= step + 1]
    if (change % 1).any() or np.ptp(near) != 1 or (near == near.max()).mean() < CUT or (near == near.min()).mean() < CUT:
        return None
    spans = np.split(time, np.flatnonzero(change > step + 1) + 1)
    for usual in sorted(RATES, key=lambda one: (one % 1 != 0, abs(rate / one - near.mean()))):
        away = [np.ptp(span - rate / usual * np.arange(len(span))) for span in spans]
        if max(away) < 1 + 1e-6:
            return rate / usual
    return None


def _locked(time: np.ndarray, rate: float, fps: float) -> float:
    """The usual rate near `fps` that the rows keep in step with, from the first to the last; else `fps`."""

    def out_of_step(one: float) -> float:
        frames = (time - time[0]) * one / rate
        return float(np.median(np.abs(frames - np.round(frames))))

    near = [one for one in RATES if abs(one - fps) < NEAR_RATE * one]
    best = min(near, key=lambda one: (round(out_of_step(one), 3), abs(one - fps)), default=fps)
    return float(best) if out_of_step(best) <= out_of_step(fps) + IN_STEP else fps


def usual_rate(fps: float) -> float:
    """A rate, or the usual one that it is."""
    nearest = min(RATES, key=lambda rate: abs(rate - fps))
    return float(nearest) if abs(nearest - fps) < SAME_RATE * nearest else round(fps, 3)
