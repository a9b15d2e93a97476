"""What moves one thing in an animation: keys, and the values between them (glTF 2.0, section 3.11 and appendix C)."""

from typing import NamedTuple

import numpy as np
import roma
import torch

TRANSLATION, ROTATION, SCALE, WEIGHTS = "translation", "rotation", "scale", "weights"
STEP, LINEAR, CUBIC = "STEP", "LINEAR", "CUBICSPLINE"
TANGENTS = 3  # values of each key of a cubic spline: the tangent in, the value, the tangent out
SAME = 1e-6  # of the largest value, within which the values of keys count as equal


class Channel(NamedTuple):
    """What moves one thing.

    Attributes:
        node: which.
        what: `translation`, `rotation`, `scale` or `weights`.
        how: STEP, LINEAR or CUBIC.
        times: of the keys, `(key,)`, seconds, rising; of two keys at one time the second holds from there.
        values: `(key, number)`, or `(key, 3, number)` of a cubic spline.
    """

    node: int
    what: str
    how: str
    times: np.ndarray
    values: np.ndarray

    @property
    def key_values(self) -> np.ndarray:
        """The values at the keys, `(key, number)`."""
        return self.values[:, 1] if self.how == CUBIC else self.values

    def at(self, times: np.ndarray) -> np.ndarray:
        """The values at times `(time,)`, `(time, number)`; before the first key and after the last, those of these."""
        last = len(self.times) - 1
        before = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last)
        if self.how == STEP:
            return self.values[before]
        after = np.minimum(before + 1, last)
        span = np.maximum(self.times[after] - self.times[before], 1e-12)[:, None]
        share = np.clip((times - self.times[before])[:, None] / span, 0, 1)
        if self.how == CUBIC:
            return self._spline(before, after, share, span)
        if self.what == ROTATION:
            return _slerp(self.values[before], self.values[after], share)
        return self.values[before] + share * (self.values[after] - self.values[before])

    def varies(self) -> bool:
        """Whether its values change from key to key, or between keys by their tangents; a rotation is its own negative."""
        values = self.key_values
        if self.what == ROTATION:
            values = np.where((values * values[:1]).sum(axis=1, keepdims=True) < 0, -values, values)
        least = SAME * max(float(np.abs(values).max()), SAME)
        tangents = self.how == CUBIC and len(values) > 1 and np.abs(self.values[:, [0, 2]]).max() > least
        return bool(np.ptp(values, axis=0).max() > least or tangents)

    def farthest_key(self) -> int:
        """The key whose values differ most from those of the first."""
        values = self.key_values
        return int(np.abs(values - values[:1]).max(axis=1).argmax())

    def _spline(self, before: np.ndarray, after: np.ndarray, share: np.ndarray, span: np.ndarray) -> np.ndarray:
        out, into = span * self.values[before, 2], span * self.values[after, 0]
        start, end = self.values[before, 1], self.values[after, 1]
        square, cube = share**2, share**3
        return (
            (2 * cube - 3 * square + 1) * start
            + (cube - 2 * square + share) * out
            + (3 * square - 2 * cube) * end
            + (cube - square) * into
        )


def _slerp(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Between unit quaternions `(time, 4)`, the shorter way."""
    both = [torch.from_numpy(np.ascontiguousarray(one, np.float64)) for one in (first, second)]
    turns = [roma.quat_normalize(one) for one in both]
    between = roma.quat_product(roma.quat_conjugation(turns[0]), turns[1])
    between = torch.where(between[:, 3:] < 0, -between, between)
    part = roma.rotvec_to_unitquat(torch.from_numpy(share) * roma.unitquat_to_rotvec(between))
    return roma.quat_product(turns[0], part).numpy()
