"""Clips of markers, and their readers for TRC and CSV; `riginv.clips.c3d` reads C3D."""

import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.clips.csv_table import gap_note, header_of, is_gap, number_in, read_csv
from riginv.clips.options import UNITS
from riginv.clips.sequence import SourceFacts
from riginv.clips.times import FrameTimes, frames_from_times
from riginv.errors import InputError, counted, listed, printable
from riginv.runs.files import is_file, read_bytes

MAX_MARKERS = 2000  # more are no markers but a scan
MAX_CELLS = 200_000_000  # of a text file
SUFFIXES = (".c3d", ".trc", ".csv")
AXIS = re.compile(r"(.+?)(?:[ ._:\-]t?| ?[(\[])([xyz])[)\]]?", re.IGNORECASE)  # `nose.x`, `nose:tx`, `nose (X)`
UNNAMED = ("*", "unlabeled", "unlabelled")  # beginnings of the names of unnamed trajectories
PLACEHOLDERS = (9999.0, 99999.0, 999999.0, 9999999.0)  # coordinates, of either sign, that stand for none
STAMP = "timestamp"  # a number, or a date, which is left out
TIMES = ("time", "seconds", "time (s)", "time [s]", "time_s", STAMP)
FRAMES = ("frame", "frame#", "field")
UNIT_WORDS = {
    "mm": "mm",
    "millimeters": "mm",
    "millimetres": "mm",
    "cm": "cm",
    "centimeters": "cm",
    "centimetres": "cm",
    "m": "m",
    "meters": "m",
    "metres": "m",
}
UNIT_WORDS |= {unit: unit for unit in UNITS} | {"in": "inch", "inches": "inch", "ft": "foot", "feet": "foot"}


@dataclass
class MarkerClip:
    """Observed markers, in the units and axes of the file.

    Attributes:
        path: the name in messages.
        names: of the markers.
        points: `(frame, marker, 3)` float32; NaN in gaps.
        frame_numbers: `(frame,)`, rising.
        facts: what was read and what was left out.
        fps: frames per second; None where the file does not give it.
        unit_mm: millimetres per unit; None where the file does not give it.
        up: the up axis, `x`, `y` or `z`; None where the file does not give it.

    Raises:
        InputError: there are no markers, no frames, too many markers, two of one name, or frame numbers that do not rise.
    """

    path: str
    names: tuple[str, ...]
    points: np.ndarray
    frame_numbers: np.ndarray
    facts: SourceFacts
    fps: float | None = None
    unit_mm: float | None = None
    up: str | None = None

    def __post_init__(self) -> None:
        if not self.names:
            raise InputError(f"{self.path}: no markers in it, expected the points of a few at least: export them with the take")
        if not len(self.points):
            raise InputError(f"{self.path}: no frames in it; expected at least one: export it again")
        if len(self.names) > MAX_MARKERS:
            raise InputError(f"{self.path}: {len(self.names)} markers, expected at most {MAX_MARKERS}: is it a scan?")
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise InputError(f"{self.path}: marker {printable(twice[0])!r} is there twice: each name once; rename one of them")
        if (np.diff(self.frame_numbers) <= 0).any():
            raise InputError(f"{self.path}: its frame numbers do not rise: each frame may occur once; renumber them")

    def select(self, names: Sequence[str], points: np.ndarray, frame_numbers: np.ndarray) -> "MarkerClip":
        """The same clip with other markers or frames."""
        return MarkerClip(self.path, tuple(names), points, frame_numbers, self.facts, self.fps, self.unit_mm, self.up)


def open_markers(path: str) -> MarkerClip:
    """The markers of a .c3d, .trc or .csv file.

    Raises:
        InputError: the file is missing or damaged, holds no markers, or has another suffix.
    """
    given = Path(path)
    suffix = given.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: clips of markers end in {', '.join(SUFFIXES)}; export the take as one of these")
    if not is_file(given):
        raise InputError(f"{path}: no such file; clip=PATH names a take of markers")
    if suffix == ".trc":
        return read_trc(given)
    from riginv.clips.c3d import read_c3d  # these need the class of this module
    from riginv.clips.marker_exports import read_export

    if suffix == ".csv":
        return read_export(given) or read_marker_csv(given)

    return read_c3d(given)


def is_unnamed(name: str) -> bool:
    """Whether the name of a trajectory says that it has none."""
    return not name or name.lower().startswith(UNNAMED)


def unnamed_note(named: int, points: int) -> tuple[str, ...]:
    """A note on the points without a name, if there are any."""
    return (f"{points - named} of {points} points have no name and were left out.",) if named < points else ()


def without_gaps(points: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Points `(frame, marker, 3)` with NaN where one stands for a gap or is not finite, and notes on the former.

    At the origin, or at one of `PLACEHOLDERS` on all three axes, stands what is not known.
    """
    at_zero = (points == 0).all(axis=2)
    placeholder = np.isin(np.abs(points), PLACEHOLDERS).all(axis=2) & (points == points[:, :, :1]).all(axis=2)
    gap = at_zero | placeholder | ~np.isfinite(points).all(axis=2)
    notes = [f"Taken as gaps: {counted(int(at_zero.sum()), 'marker')} at exactly 0, 0, 0."] if at_zero.any() else []
    if placeholder.any():
        value = float(points[placeholder][0, 0])
        notes.append(f"Taken as gaps: {counted(int(placeholder.sum()), 'marker')} at {value:g} on all axes.")
    return np.where(gap[..., None], np.nan, points).astype(np.float32), tuple(notes)


def unit_in_mm(path: Path, text: str) -> tuple[float | None, tuple[str, ...]]:
    """Millimetres per unit of a unit's name in a file; None, and a note, where it is not known."""
    word = UNIT_WORDS.get(text.strip().lower())
    if word is None:
        found = f"its unit {printable(text.strip())[:20]!r} is not known" if text.strip() else "it has no unit"
        return None, (f"{path.name}: {found}: guessed from the rig's size (reading.unit=mm sets it).",)
    return UNITS[word], ()


def read_trc(path: Path) -> MarkerClip:
    """A TRC file (Motion Analysis, OpenSim): four header lines of tab-separated fields, then a line for each frame.

    Raises:
        InputError: it is damaged.
    """
    text = _text(path)
    lines = [line.split("\t") for line in text.splitlines()]
    if len(lines) < 5 or not lines[0][0].startswith("PathFileType"):
        raise InputError(f"{path}: no TRC file: expected a first line that begins with PathFileType: export it again")
    if len(lines[3]) < 3:
        raise InputError(f"{path}, line 4: {len(lines[3])} fields, expected names of markers divided by tabs: export it again")
    header = {name.strip(): value.strip() for name, value in zip(lines[1], lines[2])}
    labels = [cell.strip() for cell in lines[3]]
    columns = [(column, name) for column, name in enumerate(labels) if column >= 2 and name]
    if any(later - column != 3 for (column, _), (later, _) in itertools.pairwise(columns)) or (columns and columns[0][0] != 2):
        raise InputError(f"{path}, line 4: markers' names must be three columns apart, from the third: export it again")
    rows = [(number, cells) for number, cells in enumerate(lines[4:], start=5) if any(cell.strip() for cell in cells)]
    if rows and not rows[0][1][0].strip():  # the line of X1, Y1, Z1
        rows = rows[1:]
    width = 2 + 3 * len(columns)
    if len(rows) * width > MAX_CELLS:
        raise InputError(f"{path}: {len(rows) * width:,} numbers, expected at most {MAX_CELLS:,}: cut the take")
    notes = []
    if rows and not text.endswith("\n") and len(rows[-1][1]) < width:
        notes.append("its last line is cut short, and was left out.")
        rows = rows[:-1]
    values, gaps = np.full((len(rows), width), np.nan), Counter[str]()
    for row, (line, cells) in enumerate(rows):
        if any(cell.strip() for cell in cells[width:]) or len(cells) < 2:
            raise InputError(
                f"{path}, line {line}: {len(cells)} fields, expected {width}: 3 for each of {len(columns)} markers"
            )
        for column, cell in enumerate(cells[:width]):
            values[row, column] = number_or_gap(path, line, cell, gaps)
    promised = header.get("NumFrames", "")
    if promised not in ("", str(len(rows))):
        notes.append(f"its header promises {promised[:12]} frames, it has {len(rows)}.")
    points, more = without_gaps(values[:, 2:].reshape(len(rows), len(columns), 3))
    times = FrameTimes(np.arange(len(rows))) if np.isnan(values[:, 0]).any() else FrameTimes(whole_numbers(path, values[:, 0]))
    rate, by_times = positive_rate(header.get("DataRate", "").replace(",", ".")), frames_from_times(values[:, 1], "times")
    if rate and by_times.fps and abs(by_times.fps / rate - 1) > 0.01:
        notes.append(f"DataRate is {rate:g}, and its times give {by_times.fps:g} frames a second: DataRate was taken.")
    unit, unit_notes = unit_in_mm(path, header.get("Units", ""))
    notes += [*gap_note(gaps), *more, *unit_notes]
    facts = SourceFacts("TRC markers", rate_source="DataRate" if rate else by_times.rate_source, notes=tuple(notes))
    return MarkerClip(str(path), tuple(name for _, name in columns), points, times.numbers, facts, rate or by_times.fps, unit)


def holds_markers(path: Path) -> bool:
    """Whether a CSV has columns of markers' axes and of frames and times alone, so that it is no table of controls."""
    titles = [title for title in header_of(path) if title]
    axes = [match for title in titles if (match := AXIS.fullmatch(title))]
    names = {match[1] for match in axes}
    others = {title.lower() for title in titles} - {match[0].lower() for match in axes}
    return bool(axes) and len(axes) == 3 * len(names) and others <= {*TIMES, *FRAMES}


def read_marker_csv(path: Path) -> MarkerClip:
    """A CSV with columns `NAME.x`, `NAME.y`, `NAME.z` for each marker, and perhaps `frame` and `time` in seconds.

    Empty cells and the other words of `GAPS` are gaps.

    Raises:
        InputError: it is damaged, or lacks an axis of a marker, or a frame's number or time.
    """
    gaps = Counter[str]()
    table = read_csv(path, gaps=gaps)
    axes: dict[str, dict[str, int]] = {}
    for column, title in enumerate(table.header):
        if match := AXIS.fullmatch(title):
            axes.setdefault(match[1], {})[match[2].lower()] = column
    if not axes:
        raise InputError(
            f"{path}: no markers in it, expected columns as nose.x, nose.y, nose.z, or an export of Motive or Vicon; found "
            f"{listed(map(printable, table.header))}"
        )
    for name, found in axes.items():
        if len(found) != 3:
            raise InputError(f"{path}: marker {name!r} has columns for {', '.join(found)}, expected x, y and z")
    columns = [found[axis] for found in axes.values() for axis in "xyz"]
    for column in columns:
        table.column(column)  # names the row of a fault
    points, notes = without_gaps(table.numbers[:, columns].reshape(len(table), len(axes), 3))
    named = {title.lower(): column for column, title in enumerate(table.header)}
    frame = next((named[name] for name in FRAMES if name in named), None)
    dated = STAMP if named.get(STAMP) in table.faults else None
    time = next((named[name] for name in TIMES if name in named and name != dated), None)
    for column in (column for column in (frame, time) if column is not None):
        if np.isnan(table.column(column)).any():
            raise InputError(f"{path}: a gap in column {table.header[column]!r}, expected a number in each row: fill it")
    times = FrameTimes(np.arange(len(table)))
    if time is not None:
        times = frames_from_times(table.column(time), "times")
    numbers = times.numbers if frame is None else whole_numbers(path, table.column(frame))
    source = SourceFacts(
        "CSV markers", rate_source=times.rate_source, notes=(*table.notes, *times.notes, *gap_note(gaps), *notes)
    )
    return MarkerClip(str(path), tuple(axes), points, numbers, source, times.fps)


def _text(path: Path) -> str:
    data = read_bytes(path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # a name in its first line


def number_or_gap(path: Path, line: int, cell: str, gaps: Counter[str]) -> float:
    """The number in a cell of a table of markers; NaN in a gap, which is counted.

    Raises:
        InputError: it holds something else.
    """
    value = number_in(cell)[0]
    if np.isnan(value) and not is_gap(cell, gaps):
        raise InputError(f"{path}, line {line}: found {printable(cell.strip())[:40]!r}, expected a number, or nothing in a gap")
    return value if abs(value) < 1e30 else np.nan


def whole_numbers(path: Path, values: np.ndarray) -> np.ndarray:
    """Frame numbers `(frame,)` as integers.

    Raises:
        InputError: one is none.
    """
    if not np.isfinite(values).all() or (values != np.round(values)).any() or (np.abs(values) > 2**53).any():
        raise InputError(f"{path}: its frame numbers are no whole numbers: renumber them")
    return values.astype(np.int64)


def positive_rate(text: str | float) -> float | None:
    """A rate in frames per second; None where it is no plausible number."""
    try:
        rate = float(text)
    except ValueError:
        return None
    return rate if 0 < rate <= 1e6 else None
