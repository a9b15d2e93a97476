"""Estimation of the frame rate from key times: glTF stores seconds and no rate."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from riginv.clips.units import DEFAULT_FPS

COMMON = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 120.0)
NTSC = {base: base * 1000 / 1001 for base in (24.0, 30.0, 48.0, 60.0, 120.0)}  # 23.976, 29.97, 47.95, 59.94, 119.88
EXACT = 5e-4  # tolerance in frames, beside the rounding of times
DECIMALS, ROUNDED = (2, 3, 4, 5), 0.16  # decimals that exporters round seconds to, and the tolerance in frames then
CLEAR = 3.5  # standard errors that distinguish a common rate from its NTSC variant
COARSE = 0.25  # greatest uncertainty of a time, frames
HOLD_S, HOLD = 2e-3, 0.15  # seconds, and fraction of a step, within which a key only holds a value up to the next key
DENSE = 8.0  # fewest keys per second whose spacing may be that of frames
SAME = 1e-4  # relative tolerance of a common rate
EVEN, UNEVEN = 0.1, 0.6  # tolerance of evenly spaced and of recorded keys, in steps
FEW, MANY = 4, 8  # keys: fewer than FEW make any rate a guess; MANY show a rate despite rounded or stray times
MOSTLY = 0.8  # fraction of the keys, for the others to count as strays


@dataclass(frozen=True)
class Rate:
    """An estimated frame rate.

    Attributes:
        fps: frames per second.
        source: of the estimate, for the user.
        tolerance: in frames, within which a key is on a frame.
        note: a sentence where the rate is a guess.
    """

    fps: float
    source: str
    tolerance: float
    note: str = ""


class KeyTimes:
    """Key times as evidence for a frame rate.

    Args:
        times: of all keys of all channels, `(key,)`, seconds.

    Attributes:
        times: unique, ascending, without keys that only hold a value.
        resolution: spacing of float32 at these times, seconds.
        rounding: rounding error of times that were rounded to decimals, seconds; else 0.
    """

    def __init__(self, times: np.ndarray) -> None:
        self.times = _without_holds(np.unique(times))
        self.resolution = float(np.spacing(np.float32(np.abs(self.times[[0, -1]]).max())))
        off = {places: np.abs(self.times - np.round(self.times, places)).max() for places in DECIMALS}
        self.rounding = next((0.5 * 0.1**places for places in DECIMALS if off[places] <= self.resolution + 1e-9), 0.0)

    def too_coarse(self) -> bool:
        """Whether float32 cannot resolve frames at times as large as these."""
        return len(self.times) > 1 and self.resolution > COARSE * float(np.median(np.diff(self.times)))

    def exact(self, fps: float) -> float:
        """Tolerance in frames for the float32 rounding of times."""
        return min(self.resolution * fps + EXACT, COARSE)

    def rounded(self, fps: float) -> float:
        """Tolerance in frames where times were rounded to decimals."""
        return min(self.rounding * fps + self.exact(fps), ROUNDED)

    def phase(self, fps: float, tolerance: float) -> float:
        """Offset of the keys from whole frames, in [-0.5, 0.5] frames: 0, or that of most keys, or of the first."""
        frames = self.times * fps
        mean = float(np.angle(np.exp(2j * np.pi * frames).mean()) / (2 * np.pi))
        for least in (1.0, MOSTLY):
            for phase in (0.0, mean):
                if (_off(frames, phase) <= tolerance).mean() >= least:
                    return phase
        return math.remainder(float(frames[0]), 1.0)

    def rate(self) -> Rate:
        """The slowest common rate on whose frames all keys lie, 30 where it is one of several; else the next best guess."""
        if len(self.times) < 2:
            return self._guess("its keys all stand at one time")
        evidence = (
            lambda: self._on_frames(self.exact, 2),
            lambda: self._on_frames(self.rounded, 3) if self.rounding else None,
            lambda: self._evenly_spaced(DENSE),
            self._mostly_on_frames,
            self._recorded,
        )
        found = next((rate for find in evidence if (rate := find())), None)
        return found or self._guess(f"its {len(self.times)} keys stand at the frames of no common rate")

    def _guess(self, reason: str) -> Rate:
        note = f"{DEFAULT_FPS:g} frames a second taken, because {reason}, and glTF does not store it (reading.fps=...)."
        return Rate(DEFAULT_FPS, "a guess", self.exact(DEFAULT_FPS), note)

    def _on_frames(self, tolerance: Callable[[float], float], least: int) -> Rate | None:
        found = [self._fitting(base, tolerance) for base in COMMON] if len(self.times) >= least else []
        fitting = [rates[0] for rates in found if rates]
        if not fitting:
            return None
        fps = _preferred(fitting)
        spaced = self._evenly_spaced(COMMON[0])
        if spaced and spaced.fps < 0.99 * fps:  # a key for every frame of an uncommon rate, such as 40
            return spaced
        alike = next(rates for rates in found if rates[:1] == [fps])[1:]
        rivals = [f"{other:.5g}" for other in (*alike, *fitting) if abs(other / fps - round(other / fps)) > SAME]
        apart = float(np.diff(self.times).min()) * fps
        note = ""
        if rivals or len(self.times) < FEW or apart > 1.5:
            others = f", as on those of {', '.join(rivals[:3])}" if rivals else ""
            wide = f", none less than {apart:.3g} frames apart" if apart > 1.5 else ""
            keys = f"its {len(self.times)} keys stand on such frames"
            note = f"{fps:.5g} frames a second taken: {keys}{wide}{others} (reading.fps=...)."
        return Rate(fps, "the frames that its keys stand on" + ", a guess" * bool(note), tolerance(fps), note)

    def _fitting(self, base: float, tolerance: Callable[[float], float]) -> list[float]:
        """A common rate and its NTSC variant, as far as they fit; only one where it clearly fits better."""
        found = {}
        for fps in (base, NTSC.get(base, base)):
            off = _off(self.times * fps, self.phase(fps, tolerance(fps)))
            if off.max() <= tolerance(fps):
                found[fps] = float(np.sqrt((off**2).mean()))
        if len(found) < 2:
            return list(found)
        better, worse = sorted(found, key=found.__getitem__)
        drift = math.sqrt(max(found[worse] ** 2 - found[better] ** 2, 0.0))
        clear = drift * math.sqrt(len(self.times)) > CLEAR * found[better]  # as many standard errors
        if clear and (better == base or len(self.times) >= MANY):
            return [better]
        return [base, NTSC[base]]

    def _evenly_spaced(self, least: float) -> Rate | None:
        """The rate of keys at every frame."""
        steps = np.diff(self.times)
        step = float(steps.mean())
        if len(steps) < 2 or step * least > 1 or np.abs(steps - step).max() > EVEN * step + self.resolution:
            return None
        fps = 1 / step
        same = np.abs(steps - step).max() <= 2 * self.resolution
        unsure = fps * (self.resolution + 2 * self.rounding * (not same)) / float(self.times[-1] - self.times[0])
        fps = float(round(fps)) if abs(fps - round(fps)) <= unsure else round(fps, 3)
        fps = _nearest(fps, (*COMMON, *NTSC.values()), SAME)
        source, note = "the even spacing of its keys", ""
        if unsure > 0.5:
            source = f"{source}, a guess"
            note = f"{fps:.5g} frames a second taken, because its keys are about {1000 * step:.3g} ms apart (reading.fps=...)."
        return Rate(fps, source, COARSE, note)

    def _mostly_on_frames(self) -> Rate | None:
        """The rate on whose frames most keys lie; the last key of a trimmed clip, for example, may not."""
        if len(self.times) < MANY:
            return None
        strays = {}
        for fps in (*COMMON, *NTSC.values()):
            off = _off(self.times * fps, self.phase(fps, self.exact(fps))) > self.exact(fps)
            if off.mean() <= 1 - MOSTLY:
                strays[fps] = int(off.sum())
        if not strays:
            return None
        fps = _preferred([rate for rate, count in strays.items() if count == min(strays.values())])
        note = (
            f"{strays[fps]} of its {len(self.times)} keys stand between the frames of {fps:.5g} a second, the others on them."
        )
        return Rate(fps, "the frames that most of its keys stand on", self.exact(fps), note)

    def _recorded(self) -> Rate | None:
        """The rate of unevenly recorded keys."""
        steps = np.diff(self.times)
        near = np.abs(steps - np.median(steps)) < UNEVEN * np.median(steps)
        step = float(steps[near].mean()) if near.mean() >= MOSTLY else math.inf
        if len(self.times) < MANY or step * DENSE > 1:
            return None
        fps = _nearest(round(1 / step, 3), COMMON, EVEN)
        note = f"{fps:.5g} frames a second taken, because its keys are {1000 * step:.3g} ms apart, unevenly (reading.fps=...)."
        return Rate(fps, "the spacing of its keys, a guess", self.exact(fps), note)


def _off(frames: np.ndarray, phase: float) -> np.ndarray:
    """Distance from whole frames after a phase."""
    after = frames - phase
    return np.abs(after - np.round(after))


def _preferred(rates: list[float]) -> float:
    return next((rate for rate in (DEFAULT_FPS, NTSC[DEFAULT_FPS]) if rate in rates), min(rates))


def _nearest(fps: float, rates: Sequence[float], near: float) -> float:
    """The nearest of some rates within a relative tolerance, else the rate itself."""
    nearest = min(rates, key=lambda rate: abs(math.log(fps / rate)))
    return nearest if abs(math.log(fps / nearest)) < near else fps


def _without_holds(times: np.ndarray) -> np.ndarray:
    """Times without those just before others: exporters hold a value by a second key, or round one time in two ways."""
    steps = np.diff(times)
    wide = steps[steps > HOLD_S]
    least = min(HOLD_S, HOLD * float(np.median(wide))) if len(wide) else 0.0
    return times[np.append(steps >= least, True)]
