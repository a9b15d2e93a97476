"""Wavefront OBJ: the vertices and faces of its `v` and `f` lines, in bulk where all lines are plain.

Texture coordinates and normals have an order of their own in an OBJ; the vertices stay whole along seams.
"""

import re
from pathlib import Path

import numpy as np

from riginv.errors import InputError
from riginv.meshes.mesh_file import MeshFile, Points
from riginv.meshes.polygons import Polygons
from riginv.text_numbers import FORTRAN_NOTE, mend_numbers, parse_numbers, reason_of

PLAIN = b"0123456789+-.eE \t\r\nv"
MENDED = PLAIN + b"na"
SPACES = bytes.maketrans(b"v", b" ")
UNUSUAL = (b" v", b"\tv", b"v\t")  # vertices that may stand elsewhere than in lines that begin with `v `
VERTEX = re.compile(rb"^[ \t]*v[ \t]+([^\n]*)", re.MULTILINE)
FACE = re.compile(rb"^[ \t]*fo?[ \t]+([^\n]*)", re.MULTILINE)
VERTEX_OR_FACE = re.compile(rb"^[ \t]*(v|fo?)[ \t]+([^\n]*)", re.MULTILINE)
OBJECT = re.compile(rb"^[ \t]*o[ \t]+([^\n]*)", re.MULTILINE)
CONTINUED = re.compile(rb"\\\r?\n")
NOT_OF_THE_VERTEX = re.compile(rb"/[^ \t\r\n]*")
CORNERS = b"0123456789 \t\r\n"
PER_LINE = (3, 4, 6, 7)  # x y z, a weight, a colour
BYTE_ORDER_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


class ObjMesh(MeshFile):
    """The mesh of an OBJ; of several objects all vertices and faces, in their order.

    Args:
        data: all bytes of the file.

    Raises:
        InputError: a line that is no vertex; the message names it.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        self.data = data = _plain_text(path, data)
        points = read_points(path, data)
        super().__init__(path, points.values, face_lines(data), points.notes)

    @property
    def objects(self) -> tuple[str, ...]:
        names = (name.strip().decode("utf-8", "replace") for name in OBJECT.findall(self.data))
        return tuple(dict.fromkeys(filter(None, names)))

    def polygons(self) -> Polygons | None:
        return read_polygons(self.path, self.data)


def _plain_text(path: Path, data: bytes) -> bytes:
    """The text in UTF-8 or another encoding that keeps ASCII, its lines ended by line feeds."""
    encoding = BYTE_ORDER_MARKS.get(data[:2])
    if encoding:
        try:
            data = data.decode(encoding).encode()
        except UnicodeDecodeError:
            raise InputError(f"{path}: text in UTF-16 that is truncated or damaged: export it again, as UTF-8") from None
    data = data.removeprefix(b"\xef\xbb\xbf")
    return data if b"\n" in data else data.replace(b"\r", b"\n")


def read_points(path: Path, data: bytes) -> Points:
    """The vertices of an OBJ in their order; a coordinate of `nan`, in any spelling, is one that is not known.

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
    data = CONTINUED.sub(b" ", data)
    lines = VERTEX.findall(data)  # of several objects, of any style
    found = _in_bulk(b"v " + b"\nv ".join(lines) + b"\n") if lines else None
    return found if found is not None else _line_by_line(path, data)


def _may_hold_vertices(part: bytes) -> bool:
    return b"v" in part and any(mark in part for mark in UNUSUAL)


def _in_bulk(block: bytes) -> Points | None:
    """The vertices of lines that are all `v` and as many numbers each; None where one is not."""
    fortran = 0
    if block.translate(None, PLAIN):
        block, fortran = mend_numbers(block)
        if block.translate(None, MENDED):
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
    return Points(values.reshape(len(marks), count)[:, :3], (FORTRAN_NOTE,) if fortran else ())


def _line_by_line(path: Path, data: bytes) -> Points:
    found: list[list[float]] = []
    fortran = 0
    for line in VERTEX.finditer(data):
        text = line[1]
        if text.translate(None, PLAIN):
            text, mended = mend_numbers(text)
            text, fortran = text.partition(b"#")[0], fortran + mended
        words = text.split()[:3]
        try:
            found.append([float(word) for word in words])
        except ValueError:
            words = []
        if len(words) < 3 or b"_" in text:  # which Python takes for a separator of thousands
            raise _wrong_line(path, data, line, "v X Y Z", reason_of(text))
    return Points(np.array(found).reshape(-1, 3), (FORTRAN_NOTE,) if fortran else ())


def face_lines(data: bytes) -> bytes:
    """What of an OBJ holds its faces, to compare two files by."""
    start, last = data.find(b"\nf "), data.rfind(b"\nf ")
    if start < 0 or data.startswith(b"f"):
        return b"\n".join(FACE.findall(data)) if b"f" in data else b""
    end = data.find(b"\n", last + 1)
    block = data[start : end if end >= 0 else len(data)].rstrip()
    return b"\n".join(FACE.findall(block)) if b"\nv " in block else block


def read_polygons(path: Path, data: bytes) -> Polygons | None:
    """The faces of an OBJ by the numbers of their vertices; None where it has none.

    Raises:
        InputError: a line that is no face; the message names it.
    """
    data = CONTINUED.sub(b" ", data) if b"\\" in data else data
    lines = FACE.findall(data)
    if not lines:
        return None
    found = _polygons_in_bulk(b"\n".join(lines) + b"\n", len(lines))
    return found if found is not None else _polygons_line_by_line(path, data)


def _polygons_in_bulk(block: bytes, faces: int) -> Polygons | None:
    """The faces of lines of positive numbers, each perhaps with others behind a slash; None where one is not."""
    vertices = NOT_OF_THE_VERTEX.sub(b"", block) if b"/" in block else block
    if vertices.translate(None, CORNERS):
        return None
    starts = _word_starts(vertices)
    if vertices is not block and len(starts) != len(_word_starts(block)):
        return None
    values = parse_numbers(vertices)
    if values is None or len(values) != len(starts) or (len(values) and values.max() >= 2**53):
        return None
    ends = np.flatnonzero(np.frombuffer(vertices, np.uint8) == ord("\n"))
    sizes = np.diff(np.searchsorted(starts, ends), prepend=0)
    return Polygons(sizes.astype(np.int64), values.astype(np.int64) - 1) if len(sizes) == faces else None


def _word_starts(text: bytes) -> np.ndarray:
    space = np.frombuffer(text, np.uint8) <= ord(" ")
    return np.flatnonzero(np.concatenate([[True], space[:-1]]) & ~space)


def _polygons_line_by_line(path: Path, data: bytes) -> Polygons:
    sizes: list[int] = []
    corners: list[int] = []
    seen = 0
    for line in VERTEX_OR_FACE.finditer(data):
        if line[1] == b"v":
            seen += 1
            continue
        words = line[2].partition(b"#")[0].split()
        try:
            for word in words:
                index = int(word.partition(b"/")[0])
                corners.append(index - 1 if index >= 0 else seen + index)  # -1: the vertex just above
        except ValueError:
            raise _wrong_line(path, data, line, "f and the numbers of its corners") from None
        sizes.append(len(words))
    try:
        return Polygons(np.array(sizes, np.int64), np.array(corners, np.int64))
    except OverflowError:
        raise InputError(f"{path}: a face uses vertex {max(map(abs, corners)) + 1}: damaged; export it again") from None


def _wrong_line(path: Path, data: bytes, line: re.Match, expected: str, reason: str = "") -> InputError:
    number = data.count(b"\n", 0, line.start()) + 1
    found = line[0].decode("utf-8", "replace").strip()[:60]
    return InputError(f"{path}, line {number}: found {found!r}, expected {expected}: {reason or 'truncated? export it again'}")
