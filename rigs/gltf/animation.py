"""An avatar's animation: the transforms of nodes and the morph weights at any time (glTF 2.0, section 3.11 and appendix C)."""

from typing import Any, NamedTuple

import numpy as np
import roma
import torch

from riginv.errors import InputError
from rigs.gltf.accessors import count_of, read_numbers
from rigs.gltf.container import GltfFile

KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
STEP, LINEAR, CUBIC = "STEP", "LINEAR", "CUBICSPLINE"
TANGENTS = 3  # values of each key of a cubic spline: the tangent in, the value, the tangent out
MOST_KEYS = 10_000_000


class Channel(NamedTuple):
    """What moves one thing.

    Attributes:
        node: which.
        what: `translation`, `rotation`, `scale` or `weights`.
        how: STEP, LINEAR or CUBIC.
        times: of the keys, `(key,)`, seconds, rising.
        values: `(key, number)`, or `(key, 3, number)` of a cubic spline.
    """

    node: int
    what: str
    how: str
    times: np.ndarray
    values: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """The values at times `(time,)`, `(time, number)`; before the first key and after the last, those of these."""
        after = np.clip(np.searchsorted(self.times, times, side="right"), 1, max(len(self.times) - 1, 1))
        before, after = after - 1, np.minimum(after, len(self.times) - 1)
        span = np.maximum(self.times[after] - self.times[before], 1e-12)[:, None]
        share = np.clip((times - self.times[before])[:, None] / span, 0, 1)
        if self.how == CUBIC:
            return self._spline(before, after, share, span)
        if self.how == STEP:
            return np.where(share < 1, self.values[before], self.values[after])
        if self.what == "rotation":
            return _slerp(self.values[before], self.values[after], share)
        return self.values[before] + share * (self.values[after] - self.values[before])

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


def read_channels(file: GltfFile, weights_of: dict[int, int]) -> list[Channel]:
    """The channels of the file's first animation.

    Args:
        weights_of: how many morph targets the nodes that have some have.

    Raises:
        InputError: there is no animation, or one of its channels is damaged.
    """
    animations = file.document.get("animations", [])
    if not animations:
        raise InputError(f"{file.path}: no animation in it: export it with its animation, or give another clip")
    animation, found = animations[0], []
    for number, channel in enumerate(animation["channels"]):
        user, target = f"animations[0].channels[{number}]", channel["target"]
        if "node" not in target or target["path"] not in KINDS:
            continue  # an extension's business
        file.item("nodes", target["node"], user)
        if channel["sampler"] >= len(animation["samplers"]):
            raise InputError(f"{file.path}: {user} names sampler {channel['sampler']} of {len(animation['samplers'])}")
        found.append(_channel(file, animation["samplers"][channel["sampler"]], target, weights_of, user))
    if not found:
        raise InputError(f"{file.path}: its animation moves nothing: export it with its animation, or give another clip")
    return found


def _channel(file: GltfFile, sampler: dict[str, Any], target: dict[str, Any], weights_of: dict[int, int], user: str) -> Channel:
    node, what, how = target["node"], target["path"], sampler.get("interpolation", LINEAR)
    if how not in (STEP, LINEAR, CUBIC):
        raise InputError(f"{file.path}: {user}: interpolation {how[:20]!r}, expected {STEP}, {LINEAR} or {CUBIC}")
    keys = count_of(file, sampler["input"], user)
    if keys > MOST_KEYS:
        raise InputError(f"{file.path}: {user} has {keys} keys: more than can be meant; export it again")
    times = read_numbers(file, sampler["input"], "SCALAR", f"input of {user}")[:, 0].astype(np.float64)
    values = read_numbers(file, sampler["output"], KINDS[what], f"output of {user}").astype(np.float64)
    width = weights_of.get(node, 0) if what == "weights" else values.shape[1]
    each = TANGENTS if how == CUBIC else 1
    if what == "weights" and not width:
        raise InputError(f"{file.path}: {user} moves morph weights of node {node}, which has no targets: export it again")
    if values.size != keys * each * width:
        raise InputError(
            f"{file.path}: output of {user} holds {values.size} numbers, expected {keys * each * width} for {keys} keys: "
            f"export it again"
        )
    if not (np.isfinite(times).all() and np.isfinite(values).all() and (np.diff(times) >= 0).all()):
        raise InputError(f"{file.path}: {user}: its times do not rise, or are no numbers: the file is damaged; export it again")
    return Channel(node, what, how, times, values.reshape((keys, TANGENTS, width) if each > 1 else (keys, width)))
