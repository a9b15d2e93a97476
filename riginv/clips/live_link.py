"""Live Link Face recordings: ARKit curves in a CSV, made into a mesh clip by adding the shapes linearly."""

import csv
import math
import re
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from riginv.curves.live_link import TIMECODE_FPS
from riginv.data.mesh_sets import WeightedShapes
from riginv.errors import InputError
from riginv.files import check_regular
from riginv.rig import RigBackend

TIMECODE = re.compile(r"(\d+):(\d\d):(\d\d):(\d\d(?:\.\d+)?)")
NOT_SHAPES = ("Timecode", "BlendShapeCount")
ANGLES = re.compile(r"(Head|LeftEye|RightEye)(Yaw|Pitch|Roll)")


class Recording(NamedTuple):
    """A recording as it stands in the file.

    Attributes:
        names: of the ARKit shapes, as ARKit writes them (`jawOpen`).
        weights: `(frame, shape)`.
        fps: frames a second, from the timecode.
    """

    names: list[str]
    weights: Tensor
    fps: float


def read_live_link(path: str | Path) -> Recording:
    """Read a Live Link Face CSV.

    Raises:
        InputError: the file is missing or unreadable, has no rows, a duplicate or missing column, or a value that is not a
            finite number; the message names the file, the row and the column.
    """
    path = Path(str(path))
    rows = _rows(path)
    header, body = rows[0], rows[1:]
    if len(set(header)) != len(header):
        twice = sorted({name for name in header if header.count(name) > 1})
        raise InputError(f"{path}: column {', '.join(map(repr, twice))} stands twice; each column must be there once")
    shapes = [name for name in header if name not in NOT_SHAPES and not ANGLES.fullmatch(name)]
    if "Timecode" not in header or not shapes:
        raise InputError(f"{path}: expected the columns of a Live Link Face recording, Timecode first; found {header[:4]}")
    if not body:
        raise InputError(f"{path}: no frames below the header; record again, or export the take once more")
    for number, row in enumerate(body, start=2):
        if len(row) != len(header):
            raise InputError(f"{path}, line {number}: {len(row)} values, expected {len(header)} as in the header")
    columns = {name: header.index(name) for name in shapes}
    weights = [
        [_number(path, number, name, row[column]) for name, column in columns.items()]
        for number, row in enumerate(body, start=2)
    ]
    names = [name[0].lower() + name[1:] for name in shapes]
    return Recording(names, torch.tensor(weights), _frames_per_second(path, [row[header.index("Timecode")] for row in body]))


def live_link_clip(path: str | Path, rig: RigBackend, name: str = "capture") -> WeightedShapes:
    """The clip of a recording: the rig's ARKit shapes added linearly to its rest mesh, without the rig's own corrections.

    Such meshes lie near the rig's space, but mostly not in it, as captured meshes do.

    Raises:
        InputError: as `read_live_link`; or the rig lacks a shape that the file moves, or the file lacks one of the rig's.
    """
    recording, shapes = read_live_link(path), rig.arkit_deltas()
    if not shapes:
        raise InputError(f"{path}: rig '{rig.name}' has no ARKit shapes that a Live Link Face recording could move")
    missing = [shape for shape in shapes if shape not in recording.names]
    if missing:
        columns = ", ".join(_column(shape) for shape in missing[:4])
        raise InputError(f"{path}: {len(missing)} of the {len(shapes)} ARKit columns are missing, the first: {columns}")
    for shape, curve in zip(recording.names, recording.weights.T):
        if shape not in shapes and curve.any():
            raise InputError(f"{path}: column {_column(shape)} moves, but rig '{rig.name}' has no ARKit shape of that name")
    order = [recording.names.index(shape) for shape in shapes]
    deltas = torch.stack(list(shapes.values()))
    return WeightedShapes(name, rig.rest_vertices, deltas, recording.weights[:, order].to(rig.dtype), recording.fps)


def _column(shape: str) -> str:
    """The column of an ARKit shape: `jawOpen` stands as JawOpen."""
    return shape[0].upper() + shape[1:]


def _rows(path: Path) -> list[list[str]]:
    check_regular(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; capture= takes the CSV of a Live Link Face recording") from None
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a CSV: {error}") from None
    if not rows:
        raise InputError(f"{path}: the file is empty; expected the CSV of a Live Link Face recording")
    return rows


def _number(path: Path, line: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}, line {line}, column {column}: found {text!r}, expected a finite number")
    return value


def _frames_per_second(path: Path, timecodes: list[str]) -> float:
    """From the first and the last timecode; a take of one frame counts as 60."""
    seconds = []
    for line, timecode in ((2, timecodes[0]), (len(timecodes) + 1, timecodes[-1])):
        match = TIMECODE.fullmatch(timecode)
        if not match:
            raise InputError(f"{path}, line {line}, column Timecode: found {timecode!r}, expected HH:MM:SS:FF.fff")
        hours, minutes, whole, frames = (float(part) for part in match.groups())
        seconds.append(3600 * hours + 60 * minutes + whole + frames / TIMECODE_FPS)
    length = (seconds[1] - seconds[0]) % (24 * 3600)
    return round((len(timecodes) - 1) / length, 3) if length > 0 else float(TIMECODE_FPS)
