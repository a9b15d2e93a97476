"""Readers of the tables of markers that capture software exports: CSV of OptiTrack Motive and of Vicon Nexus or Shogun.

Both have rows of names and axes above the frames, and other objects (rigid bodies, joints, devices) beside the markers.
"""

import csv
import io
from collections import Counter
from pathlib import Path

import numpy as np

from riginv.clips.csv_table import DELIMITERS, decoded, gap_note
from riginv.clips.markers import (
    MAX_CELLS,
    MarkerClip,
    is_unnamed,
    number_or_gap,
    positive_rate,
    unit_in_mm,
    unnamed_note,
    whole_numbers,
    without_gaps,
)
from riginv.clips.sequence import SourceFacts
from riginv.errors import InputError, printable
from riginv.runs.files import read_bytes

MOTIVE, VICON = "Format Version", "Trajectories"  # first cells of an export, and of the section of markers
FIRST_LINES = 4096  # characters that the delimiter is found in

Rows = list[list[str]]


def read_export(path: Path) -> MarkerClip | None:
    """The markers of an export of Motive or Vicon; None where a CSV is none.

    Raises:
        InputError: it is damaged, or holds no markers.
    """
    data = read_bytes(path)
    try:
        text = decoded(data)
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # a name of the take
    if not text.startswith(MOTIVE) and VICON not in text:
        return None
    delimiter = max(DELIMITERS, key=text[:FIRST_LINES].count)
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as a CSV: {error}") from None
    if rows and rows[0][:1] == [MOTIVE]:
        return _motive(path, rows)
    start = next((line for line, row in enumerate(rows) if row[:1] == [VICON]), None)
    return None if start is None else _vicon(path, rows, start)


def _motive(path: Path, rows: Rows) -> MarkerClip:
    """Pairs of names and values in the first row; below it rows of types, names, properties and axes."""
    facts = dict(zip(rows[0][::2], rows[0][1::2]))
    titles = {row[1].lower(): row for row in rows[1:12] if len(row) > 1}
    axes = _axes_row(path, rows, 1)
    types, names, kinds = titles.get("type", []), titles.get("name", []), rows[axes - 1]
    columns = [
        column
        for column in _positions(rows[axes])
        if column < min(len(types), len(names), len(kinds)) and (types[column], kinds[column]) == ("Marker", "Position")
    ]
    rate = facts.get("Export Frame Rate") or facts.get("Capture Frame Rate", "")
    named = [(names[column], column) for column in columns]
    return _clip(path, "Motive", rows, axes + 1, named, rate, facts.get("Length Units", ""))


def _vicon(path: Path, rows: Rows, start: int) -> MarkerClip:
    """From the row `Trajectories`: the rate, names above the axis X of each marker, axes, units, frames, a blank line."""
    axes = _axes_row(path, rows, start)
    names, units = rows[axes - 1], rows[axes + 1 : axes + 2]
    named = [(names[column], column) for column in _positions(rows[axes]) if column < len(names)]
    unit = next((cell for cell in units[0] if cell), "") if units else ""
    rate = rows[start + 1][0] if rows[start + 1] else ""
    end = next((line for line in range(axes + 2, len(rows)) if not any(rows[line])), len(rows))
    return _clip(path, "Vicon", rows[:end], axes + 2, named, rate, unit)


def _axes_row(path: Path, rows: Rows, start: int) -> int:
    """The index of the row that begins with `Frame` and holds the axes."""
    for line in range(start, min(start + 12, len(rows))):
        if rows[line][:1] == ["Frame"] and line > start:
            return line
    raise InputError(f"{path}: an export without its row of axes (Frame, ..., X, Y, Z): export the markers' positions again")


def _positions(axes: list[str]) -> list[int]:
    """The columns of each X that Y and Z follow."""
    return [column for column in range(2, len(axes) - 2) if axes[column : column + 3] == ["X", "Y", "Z"]]


def _clip(path: Path, source: str, rows: Rows, first: int, named: list[tuple[str, int]], rate: str, unit: str) -> MarkerClip:
    """The clip of the columns of some markers, whose frames begin at a row."""
    chosen = [(printable(name), column) for name, column in named if not is_unnamed(name)]
    frames = [(line, row) for line, row in enumerate(rows[first:], start=first + 1) if any(row)]
    if len(frames) * len(chosen) > MAX_CELLS // 3:
        raise InputError(f"{path}: {len(frames)} frames of {len(chosen)} markers: cut the take")
    columns = [0, *(column + axis for _, column in chosen for axis in range(3))]
    values, gaps = np.full((len(frames), len(columns)), np.nan), Counter[str]()
    for index, (line, row) in enumerate(frames):
        for place, column in enumerate(columns):
            values[index, place] = number_or_gap(path, line, row[column] if column < len(row) else "", gaps)
    points, notes = without_gaps(values[:, 1:].reshape(len(frames), len(chosen), 3))
    unit_mm, unit_notes = unit_in_mm(path, unit)
    notes = (*gap_note(gaps), *notes, *unnamed_note(len(chosen), len(named)), *unit_notes)
    facts = SourceFacts(f"CSV markers ({source})", rate_source="its header", notes=notes)
    numbers = whole_numbers(path, values[:, 0])
    return MarkerClip(str(path), tuple(name for name, _ in chosen), points, numbers, facts, positive_rate(rate), unit_mm)
