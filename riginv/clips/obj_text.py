"""The `v` and `f` lines of a Wavefront OBJ, fast: numbers are parsed in bulk, and what is unusual goes the slow way."""

import re
import warnings
from pathlib import Path

import numpy as np

from riginv.clips.sequence import Polygons
from riginv.errors import InputError

PLAIN = b"0123456789+-.eE \t\r\nv"
SPACES = bytes.maketrans(b"v", b" ")
UNUSUAL = (b" v", b"\tv", b"v\t")  # vertices that may stand elsewhere than in lines that begin with `v `
VERTEX = re.compile(rb"^[ \t]*v[ \t]+([^\n]*)", re.MULTILINE)
FACE = re.compile(rb"^[ \t]*([vf])[ \t]+([^\n]*)", re.MULTILINE)
CONTINUED = re.compile(rb"\\\r?\n")
PER_LINE = (3, 4, 6, 7)  # x y z, a weight, a colour


def read_points(path: Path, data: bytes) -> np.ndarray:
    """The vertices `(vertex, 3)` of an OBJ, float32, in their order; a coordinate of `nan` is one that is not known.

    Raises:
        InputError: a line that is no vertex; the message names it.
    """
    start = 0 if data.startswith(b"v ") else data.find(b"\nv ") + 1
    last = data.rfind(b"\nv ") + 1
    if data[start : start + 2] == b"v ":
        end = data.find(b"\n", max(last, start))
        block = data[start : end + 1] if end >= 0 else data[start:] + b"\n"
        around = data[:start], data[start + len(block) :]
        if b"\\" not in data and not any(_may_hold_vertices(part) for part in around):
            found = _in_bulk(block)
            if found is not None:
                return found
    return _line_by_line(path, data)


def _may_hold_vertices(part: bytes) -> bool:
    return b"v" in part and any(mark in part for mark in UNUSUAL)


def _in_bulk(block: bytes) -> np.ndarray | None:
    """The vertices of lines that are all `v` and as many numbers each; None where one is not."""
    if block.translate(None, PLAIN):
        return None
    plain = np.frombuffer(block, np.uint8)
    marks = np.flatnonzero(plain == ord("v"))
    lines = np.flatnonzero(plain == ord("\n"))
    if len(marks) != len(lines) or (plain[marks[1:] - 1] != ord("\n")).any() or (plain[lines[:-1] + 1] != ord("v")).any():
        return None
    text = block.translate(SPACES)
    space = np.frombuffer(text, np.uint8) <= ord(" ")
    starts = np.flatnonzero(space[:-1] & ~space[1:])
    count = len(starts) // len(marks)
    if count not in PER_LINE or not np.array_equal(np.searchsorted(starts, marks), count * np.arange(len(marks))):
        return None
    if len(starts) != count * len(marks):
        return None
    values = parse_numbers(text)
    if values is None or len(values) != len(starts):
        return None
    return _single(values.reshape(len(marks), count)[:, :3])


def parse_numbers(text: bytes) -> np.ndarray | None:
    """Numbers with spaces between, `(number,)` float64; None where something else stands there."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def _line_by_line(path: Path, data: bytes) -> np.ndarray:
    data = CONTINUED.sub(b" ", data)
    found: list[list[float]] = []
    for line in VERTEX.finditer(data):
        words = line[1].partition(b"#")[0].split()
        try:
            found.append([float(words[0]), float(words[1]), float(words[2])])
        except (ValueError, IndexError):
            raise _no_line(path, data, line, "v X Y Z") from None
    return _single(np.array(found).reshape(-1, 3))


def read_polygons(path: Path, data: bytes) -> Polygons | None:
    """The faces of an OBJ by the numbers of their vertices; None where it has none.

    Raises:
        InputError: a line that is no face; the message names it.
    """
    data = CONTINUED.sub(b" ", data)
    sizes: list[int] = []
    corners: list[int] = []
    seen = 0
    for line in FACE.finditer(data):
        if line[1] == b"v":
            seen += 1
            continue
        words = line[2].partition(b"#")[0].split()
        try:
            for word in words:
                index = int(word.partition(b"/")[0])
                corners.append(index - 1 if index >= 0 else seen + index)  # -1: the vertex just above
        except ValueError:
            raise _no_line(path, data, line, "f and the numbers of its corners") from None
        sizes.append(len(words))
    if not sizes:
        return None
    try:
        return Polygons(np.array(sizes, np.int64), np.array(corners, np.int64))
    except OverflowError:
        raise InputError(f"{path}: a face uses vertex {max(map(abs, corners)) + 1}: damaged; export it again") from None


def face_lines(data: bytes) -> bytes:
    """What of an OBJ holds its faces, to compare two files by: from the first to the last face."""
    start, last = data.find(b"\nf "), data.rfind(b"\nf ")
    end = data.find(b"\n", last + 1)
    return data[start : end if end >= 0 else len(data)].rstrip() if start >= 0 else b""


def _single(values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        return values.astype(np.float32)


def _no_line(path: Path, data: bytes, line: re.Match, expected: str) -> InputError:
    number = data.count(b"\n", 0, line.start()) + 1
    found = line[0].decode("latin-1").strip()[:60]
    return InputError(f"{path}, line {number}: found {found!r}, expected {expected}: truncated? export it again")
