"""Tables of numbers in CSV files of apps, spreadsheets and scripts."""

import array
import csv
import io
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.errors import InputError, counted, listed
from riginv.runs.files import check_regular

DELIMITERS = (",", ";", "\t")
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
GAPS = ("", "nan", "-", "--", "null", "none", "na", "n/a", "#n/a")  # cells of tables of markers that hold no number
CLOCK = re.compile(r"\d+[:;]\d\d?[:;]\d\d?")
REASONS = (  # why a text is no number, and the remedy
    (re.compile(r"[+-]?(\d+\.?\d*|\.\d+)[dD][+-]?\d+"), "a Fortran exponent: write E in place of D"),
    (re.compile(r"[+-]?\d{1,3}([ ',_\u00a0\u202f]\d{3})+([.,]\d*)?"), "thousands separators: leave them out"),
    (
        re.compile(r"[+-]?(nan|inf|1\.#).*", re.IGNORECASE),
        "not a finite number: leave the row out: it is interpolated from its neighbours",
    ),
    (re.compile(r"[+-]?\d*([.,]\d+)?\s*%"), "per cent: divide by 100"),
    (re.compile(r""), "an empty cell: fill it, or leave the row out"),
)


class Fault(NamedTuple):
    """A cell that is no finite number.

    Attributes:
        line: of the file, from 1.
        text: of the cell.
    """

    line: int
    text: str


@dataclass(frozen=True)
class CsvTable:
    """The rows of a CSV.

    Attributes:
        path: of the file.
        header: the names of the columns.
        numbers: `(row, column)`, float64; NaN where a cell is no finite number.
        faults: the first such cell of each affected column, by column.
        texts: the cells of the text column.
        lines: line number in the file of each row.
        notes: what was repaired.
    """

    path: Path
    header: list[str]
    numbers: np.ndarray
    faults: dict[int, Fault]
    texts: list[str]
    lines: list[int]
    notes: list[str]

    def __len__(self) -> int:
        return len(self.lines)

    def column(self, number: int) -> np.ndarray:
        """The numbers `(row,)` of a column.

        Raises:
            InputError: one of its cells is no finite number.
        """
        if number in self.faults:
            line, text = self.faults[number]
            where = f"{self.path}, line {line}, column {self.header[number]}"
            reason = next((f"; this is {why}" for pattern, why in REASONS if pattern.fullmatch(text.strip()[:40])), "")
            raise InputError(f"{where}: found {text[:60]!r}, expected a finite number{reason}")
        return self.numbers[:, number]

    def columns(self, numbers: Sequence[int]) -> np.ndarray:
        """Several columns, `(row, column)`; raises as `column`."""
        return np.stack([self.column(number) for number in numbers], axis=1)


def read_csv(path: Path, text_column: str = "", gaps: Counter[str] | None = None) -> CsvTable:
    """Read a CSV with a header; cells are separated by commas, semicolons or tabs, decimals by points or commas.

    Args:
        text_column: name in lower case of a column that holds text.
        gaps: counts the cells of each word in `GAPS`, which then are no faults; None: they are.

    Raises:
        InputError: the file is missing, empty or no CSV, has no row below the header, a row of another length than the
            header, or two columns of one name.
    """
    header, rows, delimiter = _opened(path)
    named = [name for name in header if name]
    if len(set(named)) != len(named):
        twice = sorted({name for name in named if named.count(name) > 1})
        raise InputError(f"{path}: column {', '.join(map(repr, twice))} is there twice; each column must be there once")
    text_at = next((number for number, name in enumerate(header) if name.lower() == text_column), -1)
    values, commas = array.array("d"), 0
    faults: dict[int, Fault] = {}
    texts: list[str] = []
    lines: list[int] = []
    for line, row in rows:
        row = _resized(path, header, row, line, delimiter)
        for number, cell in enumerate(row):
            value = math.nan
            if number == text_at:
                texts.append(cell.strip())
            else:
                value, has_comma = number_in(cell)
                commas += has_comma
                if math.isnan(value) and not (gaps is not None and is_gap(cell, gaps)):
                    faults.setdefault(number, Fault(line, cell))
            values.append(value)
        lines.append(line)
    if not lines:
        raise InputError(f"{path}: no frames below the header; export the take once more")
    notes = [f"{commas:,} numbers with a decimal comma were read as with a decimal point"] if commas else []
    return CsvTable(path, header, np.frombuffer(values).reshape(len(lines), -1), faults, texts, lines, notes)


def is_gap(cell: str, gaps: Counter[str]) -> bool:
    """Whether a cell holds one of `GAPS`, which is then counted."""
    word = cell.strip()
    found = word.lower() in GAPS
    if found:
        gaps[word] += 1
    return found


def gap_note(gaps: Counter[str]) -> tuple[str, ...]:
    """A note on the words that were taken as gaps, other than empty cells and NaN."""
    words = {word: count for word, count in gaps.items() if word.lower() not in GAPS[:2]}
    if not words:
        return ()
    return (f"Taken as gaps: {counted(sum(words.values()), 'cell')} of {listed(map(repr, words))}.",)


def number_in(cell: str) -> tuple[float, bool]:
    """The finite number in a cell, else NaN; and whether it had a decimal comma."""
    try:
        value = float(cell)
    except ValueError:
        if not DECIMAL_COMMA.fullmatch(cell.strip()):
            return math.nan, False
        return float(cell.replace(",", ".")), True
    return (value if math.isfinite(value) and "_" not in cell else math.nan), False


def header_of(path: Path) -> list[str]:
    """The names of the columns of a CSV.

    Raises:
        InputError: the file is missing, empty or no CSV.
    """
    return _opened(path)[0]


def _resized(path: Path, header: list[str], row: list[str], line: int, delimiter: str) -> list[str]:
    """A row with as many cells as the header.

    Raises:
        InputError: it has more or fewer that are not empty.
    """
    if delimiter == ";" and len(row) == len(header) + 1 and CLOCK.fullmatch(row[0].strip()):
        row = [f"{row[0]};{row[1]}", *row[2:]]  # a drop-frame timecode contains the delimiter
    if len(row) > len(header) and not any(cell.strip() for cell in row[len(header) :]):
        row = row[: len(header)]
    if len(row) < len(header) and not any(header[len(row) :]):
        row = [*row, *[""] * (len(header) - len(row))]  # only the header ends in a delimiter
    if len(row) != len(header):
        halves = delimiter == "," and len(row) >= 2 * len(header) - 2
        reason = "; are its decimals commas? write points, or divide the cells by semicolons" if halves else ""
        raise InputError(f"{path}, line {line}: {len(row)} values, expected {len(header)} as in the header{reason}")
    return row


def _opened(path: Path) -> tuple[list[str], Iterator[tuple[int, list[str]]], str]:
    """The header, the rows that are not empty with their line numbers, and the delimiter."""
    check_regular(path)
    try:
        text = decoded(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; a .csv is a Live Link Face recording or holds curves of controls") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as a CSV: {error}") from None
    first = text.lstrip("\r\n").partition("\n")[0]
    delimiter = max(DELIMITERS, key=first.count)
    rows = _rows(path, io.StringIO(text, newline=""), delimiter)
    header = next(rows, (0, []))[1]
    if not header:
        raise InputError(f"{path}: the file is empty; expected a Live Link Face recording or curves of controls")
    return [name.strip() for name in header], rows, delimiter


def _rows(path: Path, text: io.StringIO, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(text, delimiter=delimiter)
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                yield reader.line_num, row
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as a CSV: {error}") from None


def decoded(data: bytes) -> str:
    """Decode UTF-8, or UTF-16, which spreadsheets write as `Unicode text`."""
    return data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
