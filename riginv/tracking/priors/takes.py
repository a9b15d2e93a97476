"""Controls of takes that priors are learned from: curves.csv of riginv.invert, and Live Link Face recordings."""

import csv
import math
from pathlib import Path

import torch
from torch import Tensor

from riginv.clips.live_link import live_link_clip
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.files import check_regular
from riginv.solvers.clip import smoothed, solve_clip
from riginv.solvers.every_mesh import solve_frames
from riginv.solvers.objective import Objective

SMOOTHNESS, STEPS, BLUR = 1.5, 4, 3.0  # of a recording's curves, as in riginv.invert
LIVE_LINK = "Timecode"  # the first column of a Live Link Face recording


def controls_of(take: Path, rig: LinearRig, first: int | None = None, last: int | None = None) -> Tensor:
    """The controls `(frame, control)` of a take; a Live Link Face recording is inverted first.

    Args:
        first, last: rows to take, from 0, both included; None: from the start, to the end.

    Raises:
        InputError: the file is missing or damaged, names other controls, or has no such rows.
    """
    check_regular(take)
    try:
        with take.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = next(reader, [])
            recorded = header[:1] == [LIVE_LINK]
            rows = [] if recorded else list(reader)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{take}: cannot be read: {error}; takes= names curves.csv files and Live Link recordings") from None
    part = slice(first, None if last is None else last + 1)
    found = _inverted(take, rig, part) if recorded else _read(take, rig, header, rows)[part]
    if not len(found):
        raise InputError(f"{take}: no rows from {first} to {last}")
    return found


def _read(take: Path, rig: LinearRig, header: list[str], rows: list[list[str]]) -> Tensor:
    column = {name: number for number, name in enumerate(header)}
    missing = [name for name in rig.control_names if name not in column]
    if missing:
        raise InputError(
            f"{take}: no column for {len(missing)} of the {len(rig.controls)} controls of rig '{rig.name}', the first: "
            f"{', '.join(missing[:4])}; expected a curves.csv of this rig, or a Live Link Face recording"
        )
    columns = [column[name] for name in rig.control_names]
    found = []
    for line, row in enumerate(rows, start=2):
        try:
            values = [float(row[number]) for number in columns]
        except (ValueError, IndexError):
            values = [math.nan]
        if not all(math.isfinite(value) for value in values):
            raise InputError(f"{take}, line {line}: expected a finite number for each control: damaged; export it again")
        found.append(values)
    return torch.tensor(found, dtype=rig.dtype).reshape(-1, len(columns)).clamp(rig.lower, rig.upper)


def _inverted(take: Path, rig: LinearRig, part: slice) -> Tensor:
    """The controls of a recording whose ARKit shapes are added linearly, smooth, as `method=clip` finds them."""
    clip = live_link_clip(take, rig)
    clip.weights = clip.weights[part]
    if not len(clip.weights):
        return torch.zeros(0, len(rig.controls))
    in_space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    objective = Objective(in_space)
    coordinates = torch.cat([in_space.space.encode(vertices) for _, vertices in clip.batches()])
    found = solve_frames(objective, coordinates, rounds=0)
    return objective.to_controls(solve_clip(objective, coordinates, smoothed(found, BLUR), SMOOTHNESS, STEPS))
