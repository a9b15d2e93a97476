"""Animation channels: keys and interpolation (glTF 2.0, section 3.11 and appendix C)."""

from typing import NamedTuple

import numpy as np
import roma
import torch

TRANSLATION, ROTATION, SCALE, WEIGHTS = "translation", "rotation", "scale", "weights"
STEP, LINEAR, CUBIC = "STEP", "LINEAR", "CUBICSPLINE"
TANGENTS = 3  # values of each key of a cubic spline: in-tangent, value, out-tangent
SAME = 1e-6  # relative tolerance within which key values are equal


class Channel(NamedTuple):
    """Animation of one property of a node.

    Attributes:
        node: index of the node.
        path: `translation`, `rotation`, `scale` or `weights`.
        interpolation: STEP, LINEAR or CUBIC.
        times: of the keys, `(key,)`, seconds, ascending; where two keys have one time the second applies from there on.
        values: `(key, number)`, or `(key, 3, number)` of a cubic spline.
    """

    node: int
    path: str
    interpolation: str
    times: np.ndarray
    values: np.ndarray

    @property
    def key_values(self) -> np.ndarray:
        """Values at the keys, `(key, number)`."""
        return self.values[:, 1] if self.interpolation == CUBIC else self.values

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values `(time, number)` at times `(time,)`, held constant before the first key and after the last."""
        last = len(self.times) - 1
        before = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last)
        if self.interpolation == STEP:
            return self.values[before]
        after = np.minimum(before + 1, last)
        span = np.maximum(self.times[after] - self.times[before], 1e-12)[:, None]
        fraction = np.clip((times - self.times[before])[:, None] / span, 0, 1)
        if self.interpolation == CUBIC:
            return self._spline(before, after, fraction, span)
        if self.path == ROTATION:
            return _slerp(self.values[before], self.values[after], fraction)
        return self.values[before] + fraction * (self.values[after] - self.values[before])

    def varies(self) -> bool:
        """Whether the values change at or between keys; a quaternion equals its negative."""
        values = self.key_values
        if self.path == ROTATION:
            values = np.where((values * values[:1]).sum(axis=1, keepdims=True) < 0, -values, values)
        least = SAME * max(float(np.abs(values).max()), SAME)
        tangents = self.interpolation == CUBIC and len(values) > 1 and np.abs(self.values[:, [0, 2]]).max() > least
        return bool(np.ptp(values, axis=0).max() > least or tangents)

    def farthest_key(self) -> int:
        """Index of the key that differs most from the first."""
        values = self.key_values
        return int(np.abs(values - values[:1]).max(axis=1).argmax())

    def _spline(self, before: np.ndarray, after: np.ndarray, t: np.ndarray, span: np.ndarray) -> np.ndarray:
        out, into = span * self.values[before, 2], span * self.values[after, 0]
        start, end = self.values[before, 1], self.values[after, 1]
        square, cube = t**2, t**3
        return (
            (2 * cube - 3 * square + 1) * start
            + (cube - 2 * square + t) * out
            + (3 * square - 2 * cube) * end
            + (cube - square) * into
        )


def _slerp(first: np.ndarray, second: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Spherical interpolation of quaternions `(time, 4)` along the shorter arc."""
    start, end = (roma.quat_normalize(torch.from_numpy(np.ascontiguousarray(one, np.float64))) for one in (first, second))
    between = roma.quat_product(roma.quat_conjugation(start), end)
    between = torch.where(between[:, 3:] < 0, -between, between)
    part = roma.rotvec_to_unitquat(torch.from_numpy(fraction) * roma.unitquat_to_rotvec(between))
    return roma.quat_product(start, part).numpy()
