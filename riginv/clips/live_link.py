"""Live Link Face recordings: ARKit weights in a CSV, turned into meshes by adding the shapes linearly."""

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.clips.csv_table import CsvTable, read_csv
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons, SourceFacts
from riginv.clips.timecode import timing
from riginv.errors import InputError, listed
from riginv.rig.arkit import ARKIT_NAMES, plain_name
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import WeightedShapes

TIMECODE = "timecode"
APP_COLUMNS = re.compile(r"timecode|blendshapecount|(head|lefteye|righteye)(yaw|pitch|roll)|")  # of the app, plain
OTHER_COLUMNS = re.compile(  # columns that other programs add
    r"(head|lefteye|righteye)(pos|position|rot|rotation)[xyzw]?|(frame|row|sample)?(index|number|id)?|"
    r"(time|timestamp|seconds|date|device|subject|slate|take|name|confidence|tracked|isvalid)(s|ms)?"
)
ANGLES = re.compile(r"(head|lefteye|righteye)(yaw|pitch|roll)")
MOVES = 1e-3  # change of a weight that matters
UNUSUAL = 0.05  # distance from [0, 1] from which weights are reported
PER_CENT = 10.0  # distance from [0, 1] from which they are no weights
FORMAT = "Live Link Face CSV"


class Recording(NamedTuple):
    """A recording as the file has it.

    Attributes:
        names: of the shapes, as ARKit spells them (`jawOpen`); columns that may be other shapes keep their names.
        weights: `(frame, shape)`.
        fps: frames per second, from the timecodes.
        frame_numbers: `(frame,)`, from 0, with gaps where rows are missing.
        facts: what was read, repaired or left out.
    """

    names: list[str]
    weights: Tensor
    fps: float
    frame_numbers: np.ndarray
    facts: SourceFacts


def read_live_link(path: str | Path) -> Recording:
    """Read a Live Link Face CSV, of any version of the app.

    Raises:
        InputError: the file is missing or unreadable, has no rows, a duplicate column, no timecodes, or a value that is not a
            finite number; the message names the file, the row and the column.
    """
    return recording_of(read_csv(Path(str(path)), TIMECODE))


def is_recording(table: CsvTable) -> bool:
    """Whether a table has a column of timecodes."""
    return TIMECODE in (name.lower() for name in table.header)


def recording_of(table: CsvTable) -> Recording:
    """The recording of a table with timecodes; raises as `read_live_link`."""
    columns = _columns(table)
    if not is_recording(table) or not columns:
        raise InputError(
            f"{table.path}: expected the columns of a Live Link Face recording, Timecode first; found {table.header[:4]}"
        )
    when = timing(table.path, table.texts, table.lines)
    weights = table.columns(list(columns.values()))[when.kept]
    notes = [*table.notes, *when.notes, *_left_out(table, columns), *_beyond(table.path, list(columns), weights)]
    facts = SourceFacts(FORMAT, rate_source=when.rate_source, notes=tuple(notes))
    return Recording(list(columns), torch.tensor(weights, dtype=torch.float32), when.fps, when.frame_numbers, facts)


def _columns(table: CsvTable) -> dict[str, int]:
    """The columns of shapes by name: ARKit's in any spelling, and others that hold weights."""
    arkit = {name.lower(): name for name in ARKIT_NAMES}
    found: dict[str, int] = {}
    for number, column in enumerate(table.header):
        name = arkit.get(plain_name(column))
        if name is None:
            is_other = any(pattern.fullmatch(plain_name(column)) for pattern in (APP_COLUMNS, OTHER_COLUMNS))
            if is_other or number in table.faults or not _are_weights(table.numbers[:, number]):
                continue
            name = column[0].lower() + column[1:]
        if name in found:
            raise InputError(f"{table.path}: columns {table.header[found[name]]} and {column} are one shape: leave one out")
        found[name] = number
    return found


def _are_weights(values: np.ndarray) -> bool:
    """Whether an unknown column may be weights of a shape: it changes between about 0 and 1, and not all are integers."""
    return bool(values.min() > -1 and values.max() < 2 and np.ptp(values) > MOVES and (values % 1 != 0).any())


def _left_out(table: CsvTable, shapes: dict[str, int]) -> list[str]:
    others = [number for number in range(len(table.header)) if number not in shapes.values()]
    angles = [n for n in others if ANGLES.fullmatch(plain_name(table.header[n])) and n not in table.faults]
    moved = any(np.ptp(table.numbers[:, number]) > MOVES for number in angles)
    unknown = [repr(table.header[n]) for n in others if not APP_COLUMNS.fullmatch(plain_name(table.header[n]))]
    notes = ["the rotations of head and eyes were left out: the meshes stay where the rig has them"] if moved else []
    if unknown:
        notes.append(f"columns that are no weights of shapes were left out: {listed(unknown)}")
    return notes


def _beyond(path: Path, names: list[str], weights: np.ndarray) -> list[str]:
    """A note on weights outside [0, 1]; raises InputError where the values are implausible as weights."""
    away = np.maximum(weights - 1, -weights)
    row, column = np.unravel_index(int(away.argmax()), away.shape)
    most = f"{names[column]} is {weights[row, column]:.4g} in row {row + 1}"
    if away[row, column] > PER_CENT:
        raise InputError(f"{path}: {most}, expected weights from 0 to 1: if they are per cent, divide them by 100")
    beyond = np.count_nonzero(away > UNUSUAL)
    return [f"{beyond:,} weights are beyond 0 to 1 and were read unchanged; {most}"] if beyond else []


def live_link_clip(path: str | Path, rig: RigBackend, name: str = "capture") -> WeightedShapes:
    """The meshes of a recording as a set, see `RecordedShapes`."""
    shapes = RecordedShapes(read_csv(Path(str(path)), TIMECODE), rig, ReadingOptions()).shapes
    shapes.name = name
    return shapes


class RecordedShapes(MeshSequence):
    """The meshes of a recording: the rig's ARKit shapes added linearly to its rest mesh, without the rig's corrections.

    Like captured meshes, they lie near the rig's space but mostly not in it.

    Args:
        table: of the recording.
        rig: has the shapes.
        options: `unknown` decides on shapes that only the file or only the rig has.

    Raises:
        InputError: as `read_live_link`; or the rig lacks a shape that the file moves, or the file lacks one of the rig's.
    """

    in_rig_space = True

    def __init__(self, table: CsvTable, rig: RigBackend, options: ReadingOptions) -> None:
        recording, shapes = recording_of(table), rig.arkit_deltas()
        if not shapes:
            raise InputError(
                f"{table.path}: rig '{rig.name}' has no ARKit shapes that a Live Link Face recording could move: give a clip "
                f"of its mesh, or curves of its own controls"
            )
        notes = [*_mapped(recording, rig), *_unknown(table, recording, rig, options)]
        used = [shape for shape in shapes if shape in recording.names]
        deltas = torch.stack([shapes[shape] for shape in used])
        weights = recording.weights[:, [recording.names.index(shape) for shape in used]].to(rig.dtype)
        self.shapes = WeightedShapes("recording", rig.rest_vertices, deltas, weights, recording.fps)
        faces = Polygons.triangles(rig.faces.cpu().numpy())
        facts = replace(recording.facts, notes=(*recording.facts.notes, *notes))
        super().__init__(table.path, recording.frame_numbers, len(rig.rest_vertices), faces, recording.fps, 1.0, "y", facts)

    def read(self, start: int, stop: int) -> np.ndarray:
        return self.shapes.vertices(start, stop).float().cpu().numpy()


def _mapped(recording: Recording, rig: RigBackend) -> list[str]:
    """Notes on shapes that the rig splits or merges."""
    parts = {name: found for name, found in rig.arkit_parts().items() if name in recording.names}
    split = [f"{name} drives {' and '.join(found.names)}" for name, found in parts.items() if len(found.names) > 1]
    merged: dict[str, list[str]] = {}
    for name, found in parts.items():
        if found.factor != 1:
            merged.setdefault(found.names[0], []).append(name)
    split += [f"the mean of {' and '.join(names)} drives {shape}" for shape, names in merged.items()]
    return [f"shapes that the rig splits or merges: {'; '.join(split)}"] if split else []


def _unknown(table: CsvTable, recording: Recording, rig: RigBackend, options: ReadingOptions) -> list[str]:
    """Notes on shapes that only the file or only the rig has.

    Raises:
        InputError: such shapes matter, and `options.unknown` does not accept them.
    """
    shapes, notes = rig.arkit_deltas(), []
    missing = [_column(shape) for shape in shapes if shape not in recording.names]
    if missing and not options.accepts_missing:
        raise InputError(
            f"{table.path}: {len(missing)} of the {len(shapes)} ARKit columns are missing, the first: "
            f"{', '.join(missing[:4])}; reading.unknown=ignore_missing lets these shapes stay at 0"
        )
    if missing:
        notes.append(f"shapes without a column stay at 0: {', '.join(missing)}")
    new = [
        name
        for name, curve in zip(recording.names, recording.weights.T)
        if name not in shapes and float(curve.abs().max()) > MOVES
    ]
    if new and not options.accepts_new:
        raise InputError(
            f"{table.path}: column {_column(new[0])} moves, but rig '{rig.name}' has no ARKit shape of that name"
            f"{f' (nor of {len(new) - 1} more)' if len(new) > 1 else ''}; reading.unknown=ignore_new leaves it out"
        )
    if new:
        notes.append(f"columns that move what the rig lacks were left out: {', '.join(map(_column, new))}")
    return notes


def _column(shape: str) -> str:
    """The column name of an ARKit shape: `JawOpen` for `jawOpen`."""
    return shape[0].upper() + shape[1:]
