"""Fewer keys: each curve keeps the keys that it takes for the rig's mesh to stay within a tolerance of what it was."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from riginv.animation.animation import Animation
from riginv.errors import InputError
from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig, RigBackend

BATCH_SIZE = 128  # meshes at a time
LOOKED_AT = 6  # frames of the clip, at which the reach of each control is measured
STEP = 0.05  # of a control's range
TIGHTER = 0.8  # of what a frame was allowed, where its mesh went too far
MOST_PASSES = 25  # after which frames that are still too far off become keys of every curve
FIRST_WINDOW = 32  # frames


@dataclass(frozen=True)
class Reduction:
    """What came of a reduction.

    Attributes:
        animation: with keys; its controls are the curves that these make.
        keys: how many there are, over all curves.
        keys_before: how many there were.
        worst_mm: the farthest that any vertex of any frame went.
    """

    animation: Animation
    keys: int
    keys_before: int
    worst_mm: float


def reduced(animation: Animation, tolerance_mm: float, advance: Callable[[str], None] | None = None) -> Reduction:
    """Keep as few keys as keep every vertex of every frame within a tolerance; between keys curves are linear.

    How far a control may stray follows from how far it moves the mesh. Each curve goes from key to key as far as one straight
    line serves; the rig then makes the meshes, and frames that went too far are allowed less, until all hold. Keys lie on
    frames and keep their values, so curves stay within their limits.

    Args:
        tolerance_mm: of any vertex.
        advance: told about each pass.

    Raises:
        InputError: the tolerance is not a number above 0.
    """
    if not 0 < tolerance_mm < float("inf"):
        raise InputError(f"tolerance_mm is {tolerance_mm}, expected a number above 0")
    controls, seconds = animation.controls.detach().cpu().double().numpy(), animation.seconds.numpy()
    frames, count = controls.shape
    allowed = tolerance_mm / _reach_mm(animation).numpy()
    share = np.ones(frames)
    for number in itertools.count():
        keys = [straight_line_keys(seconds, controls[:, c], allowed[c] * share) for c in range(count)]
        curves = np.stack([np.interp(seconds, seconds[rows], controls[rows, c]) for c, rows in enumerate(keys)], axis=1)
        made = torch.tensor(curves).to(animation.controls)
        apart = distances_mm(animation.rig, animation.controls, made)
        too_far = apart > tolerance_mm
        if advance:
            advance(f"pass {number + 1}: {sum(map(len, keys))} keys, {int(too_far.sum())} frames beyond {tolerance_mm:g} mm")
        if not too_far.any():
            break
        if number + 1 >= MOST_PASSES:
            share[too_far] = 0
        share[too_far] *= np.minimum(TIGHTER, tolerance_mm / apart[too_far])
    kept = tuple(torch.tensor(rows) for rows in keys)
    worst = float(apart.max())
    return Reduction(replace(animation, controls=made, keys=kept), sum(map(len, keys)), frames * count, worst)


def straight_line_keys(seconds: np.ndarray, values: np.ndarray, allowed: np.ndarray) -> list[int]:
    """The rows of a curve that stay keys: from each the next is the farthest to which one straight line serves.

    Args:
        seconds: `(frame,)`, rising.
        values: `(frame,)`.
        allowed: `(frame,)`, how far the line may be off there.
    """
    last, row, keys = len(values) - 1, 0, [0]
    if (np.abs(values - values[0]) <= allowed).all():
        return keys
    while row < last:
        row = _farthest(seconds, values, allowed, row)
        keys.append(row)
    return keys


def _farthest(seconds: np.ndarray, values: np.ndarray, allowed: np.ndarray, row: int) -> int:
    """The last frame that a line from frame `row` may end on: its slope lies between those that pass all frames between."""
    window, last = FIRST_WINDOW, len(values) - 1
    while True:
        stop = min(row + window, last)
        away = seconds[row + 1 : stop + 1] - seconds[row]
        rise, slack = values[row + 1 : stop + 1] - values[row], allowed[row + 1 : stop + 1]
        lowest, highest = np.maximum.accumulate((rise - slack) / away), np.minimum.accumulate((rise + slack) / away)
        derivative = rise / away
        serves = (derivative[1:] >= lowest[:-1]) & (derivative[1:] <= highest[:-1])
        closed = np.flatnonzero(lowest > highest)
        if len(closed) or stop == last:
            reached = np.flatnonzero(serves)
            return row + 2 + int(reached[-1]) if len(reached) else row + 1
        window *= 2


@torch.no_grad()
def _reach_mm(animation: Animation) -> Tensor:
    """How far each control moves any vertex, `(control,)`, mm for one of its units, at frames spread over the clip."""
    rig, controls = animation.rig, animation.controls
    rows = evenly(LOOKED_AT, len(controls))
    reach = torch.full((len(rig.controls),), 1e-9, dtype=torch.float64)
    steps = STEP * (rig.upper - rig.lower)
    for pose in (rig.neutral_controls.to(controls), *controls[rows]):
        signs = torch.where(pose + steps <= rig.upper, 1.0, -1.0)
        moved = distances_mm(rig, pose.expand(len(steps), -1), pose + torch.diag(signs * steps))
        reach = torch.maximum(reach, torch.tensor(moved) / steps.double().cpu())
    return reach


@torch.no_grad()
def distances_mm(rig: RigBackend, before: Tensor, after: Tensor) -> np.ndarray:
    """How far the vertex that moved most went, `(mesh,)`, mm, from one set of controls `(mesh, control)` to another."""
    found = []
    for one, other in zip(before.split(BATCH_SIZE), after.split(BATCH_SIZE)):
        if isinstance(rig, LinearRig):
            change = (rig.coefficients(other) - rig.coefficients(one)) @ rig.basis.flatten(1)
            found.append(change.unflatten(1, (-1, 3)).norm(dim=2).amax(dim=1))
        else:
            found.append((rig(other) - rig(one)).norm(dim=2).amax(dim=1))
    return torch.cat(found).double().cpu().numpy()
