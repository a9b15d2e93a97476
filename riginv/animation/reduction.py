"""Key reduction: as few keys as possible with the rig's mesh within a tolerance."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from riginv.animation.animation import Animation
from riginv.errors import InputError
from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig, RigBackend

BATCH_SIZE = 128  # meshes
SAMPLED_FRAMES = 6  # at which the effect of each control is measured
STEP = 0.05  # of a control's range
TIGHTER = 0.8  # factor of the tolerance of frames whose mesh is too far off
MAX_PASSES = 25  # then frames that are still too far off become keys of every curve
FIRST_WINDOW = 32  # frames


@dataclass(frozen=True)
class Reduction:
    """The result of a key reduction.

    Attributes:
        animation: with keys; its controls are the curves between these.
        keys: number of keys of all curves.
        keys_before: number before the reduction.
        worst_mm: largest displacement of any vertex in any frame.
    """

    animation: Animation
    keys: int
    keys_before: int
    worst_mm: float


def reduced(animation: Animation, tolerance_mm: float) -> Reduction:
    """Remove as many keys as possible with every vertex of every frame within a tolerance; curves are linear between keys.

    The tolerance of a control follows from how far it moves the mesh. Each line of a curve extends as far as it is within the
    tolerance; then the rig makes the meshes, and the tolerance of frames that are too far off is reduced until all hold. Keys
    are on frames and keep their values, so curves stay within their limits.

    Args:
        tolerance_mm: of any vertex.

    Raises:
        InputError: the tolerance is not a number above 0.
    """
    if not 0 < tolerance_mm < float("inf"):
        raise InputError(f"tolerance_mm is {tolerance_mm}, expected a number above 0")
    controls, seconds = animation.controls.detach().cpu().double().numpy(), animation.seconds.numpy()
    frames, count = controls.shape
    tolerance = tolerance_mm / _effect_mm(animation).numpy()
    factor = np.ones(frames)
    for number in itertools.count():
        keys = [straight_line_keys(seconds, controls[:, c], tolerance[c] * factor) for c in range(count)]
        curves = np.stack([np.interp(seconds, seconds[rows], controls[rows, c]) for c, rows in enumerate(keys)], axis=1)
        made = torch.tensor(curves).to(animation.controls)
        distance = distances_mm(animation.rig, animation.controls, made)
        too_far = distance > tolerance_mm
        if not too_far.any():
            break
        if number + 1 >= MAX_PASSES:
            factor[too_far] = 0
        factor[too_far] *= np.minimum(TIGHTER, tolerance_mm / distance[too_far])
    key_rows = tuple(torch.tensor(rows) for rows in keys)
    worst = float(distance.max())
    return Reduction(replace(animation, controls=made, keys=key_rows), sum(map(len, keys)), frames * count, worst)


def straight_line_keys(seconds: np.ndarray, values: np.ndarray, tolerance: np.ndarray) -> list[int]:
    """Rows of the keys of a curve: each line extends as far as it is within the tolerance.

    Args:
        seconds: `(frame,)`, rising.
        values: `(frame,)`.
        tolerance: of the line, `(frame,)`.
    """
    last, row, keys = len(values) - 1, 0, [0]
    if (np.abs(values - values[0]) <= tolerance).all():
        return keys
    while row < last:
        row = _farthest(seconds, values, tolerance, row)
        keys.append(row)
    return keys


def _farthest(seconds: np.ndarray, values: np.ndarray, tolerance: np.ndarray, row: int) -> int:
    """The last frame on which a line from frame `row` may end: its slope is within the bounds of all frames between."""
    window, last = FIRST_WINDOW, len(values) - 1
    while True:
        stop = min(row + window, last)
        elapsed = seconds[row + 1 : stop + 1] - seconds[row]
        rise, slack = values[row + 1 : stop + 1] - values[row], tolerance[row + 1 : stop + 1]
        lowest, highest = np.maximum.accumulate((rise - slack) / elapsed), np.minimum.accumulate((rise + slack) / elapsed)
        slope = rise / elapsed
        is_valid = (slope[1:] >= lowest[:-1]) & (slope[1:] <= highest[:-1])
        closed = np.flatnonzero(lowest > highest)
        if len(closed) or stop == last:
            reached = np.flatnonzero(is_valid)
            return row + 2 + int(reached[-1]) if len(reached) else row + 1
        window *= 2


@torch.no_grad()
def _effect_mm(animation: Animation) -> Tensor:
    """Largest vertex displacement by each control, `(control,)`, mm per unit, at frames spread over the clip."""
    rig, controls = animation.rig, animation.controls
    rows = evenly(SAMPLED_FRAMES, len(controls))
    effect = torch.full((len(rig.controls),), 1e-9, dtype=torch.float64)
    steps = STEP * (rig.upper - rig.lower)
    for pose in (rig.neutral_controls.to(controls), *controls[rows]):
        signs = torch.where(pose + steps <= rig.upper, 1.0, -1.0)
        moved = distances_mm(rig, pose.expand(len(steps), -1), pose + torch.diag(signs * steps))
        effect = torch.maximum(effect, torch.tensor(moved) / steps.double().cpu())
    return effect


@torch.no_grad()
def distances_mm(rig: RigBackend, before: Tensor, after: Tensor) -> np.ndarray:
    """Largest vertex displacement `(mesh,)`, mm, from one set of controls `(mesh, control)` to another."""
    found = []
    for one, other in zip(before.split(BATCH_SIZE), after.split(BATCH_SIZE)):
        if isinstance(rig, LinearRig):
            change = (rig.coefficients(other) - rig.coefficients(one)) @ rig.basis.flatten(1)
            found.append(change.unflatten(1, (-1, 3)).norm(dim=2).amax(dim=1))
        else:
            found.append((rig(other) - rig(one)).norm(dim=2).amax(dim=1))
    return torch.cat(found).double().cpu().numpy()
