"""Takes that priors are learned from: control curves (`curves.csv` of riginv.invert, .npz) and Live Link Face recordings."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from riginv.clips.live_link import RecordedShapes
from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.units import DEFAULT_FPS
from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import WeightedShapes
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.band import second_differences, usual_steps
from riginv.solvers.clip import smoothed, solve_clip
from riginv.solvers.every_mesh import solve_frames
from riginv.solvers.objective import Objective
from riginv.tracking.priors.prior import ControlPrior

SMOOTHNESS, STEPS, BLUR = 1.5, 4, 3.0  # of a recording's curves, as in riginv.invert
READING = ReadingOptions(unknown="ignore_new")  # columns that are no controls of the rig do not matter
LEAST = 0.01  # of its range: standard deviation of a second difference at `LEAST_FPS` that every control has at least
LEAST_FPS = 30.0


class Take(NamedTuple):
    """Controls of a take `(frame, control)`, notes on how they were read, frame numbers `(frame,)` and rows in a second."""

    controls: Tensor
    notes: tuple[str, ...]
    numbers: Tensor
    rate: float


def read_take(path: Path, rig: LinearRig, first: int | None = None, last: int | None = None) -> Take:
    """Read a take; a Live Link Face recording is inverted.

    Args:
        first, last: rows to take, from 0, both included; None: from the start, to the end.

    Raises:
        InputError: the file is missing or damaged, holds no curves of this rig, or has no such rows.
    """
    part = slice(first, None if last is None else last + 1)
    sequence = open_sequence(str(path), rig, READING)
    if isinstance(sequence, RecordedShapes):
        controls = _inverted(sequence.shapes, rig, part)
    elif sequence.controls is not None:
        controls = torch.from_numpy(sequence.controls).to(rig.lower)[part]
    else:
        raise InputError(f"{path}: meshes, expected curves of controls or a Live Link Face recording: invert it first")
    if not len(controls):
        raise InputError(f"{path}: no rows from {first} to {last}")
    numbers = torch.as_tensor(sequence.frame_numbers)[part]
    return Take(controls, sequence.facts.notes, numbers, row_rate(sequence.fps or DEFAULT_FPS, numbers))


def row_rate(fps: float, numbers: Tensor) -> float:
    """The rows in a second of frames with these numbers, of which no more than usual are missing."""
    return fps / max(float(numbers.diff().double().median()), 1.0) if len(numbers) > 1 else fps


def _inverted(recording: WeightedShapes, rig: LinearRig, part: slice) -> Tensor:
    """The controls of a recording whose ARKit shapes are added linearly, smooth, as `method=clip` finds them."""
    recording.weights = recording.weights[part]
    if not len(recording.weights):
        return torch.zeros(0, len(rig.controls))
    in_space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    objective = Objective(in_space)
    coordinates = torch.cat([in_space.space.encode(vertices) for _, vertices in recording.batches()])
    found = solve_frames(objective, coordinates, rounds=0)
    return objective.to_controls(solve_clip(objective, coordinates, smoothed(found, BLUR), SMOOTHNESS, STEPS))


def with_changes(prior: ControlPrior, rig: RigBackend, takes: Sequence[Take]) -> ControlPrior:
    """The prior with the covariance of the controls' second differences; as it is where no take has three frames in a row."""
    lower, span = rig.lower.double().cpu(), (rig.upper - rig.lower).double().cpu()
    total, count = torch.zeros_like(prior.covariance), 0
    for take in (take for take in takes if len(take.numbers) > 2):
        weights = second_differences(usual_steps(take.numbers))
        units = ((take.controls.double().cpu() - lower) / span).clamp(0, 1)
        second = weights[:, :1] * units[:-2] + weights[:, 1:2] * units[1:-1] + weights[:, 2:] * units[2:]
        second = second[weights.any(dim=1)]  # not across long gaps
        total, count = total + take.rate**3 * (second.T @ second), count + len(second)
    if not count:
        return prior
    least = LEAST**2 * LEAST_FPS**3 * torch.eye(len(total), dtype=torch.float64)
    return replace(prior, changes=total / count + least)
