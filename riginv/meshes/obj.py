"""Wavefront OBJ: the vertices and faces of its `v` and `f` lines, parsed in bulk where all lines are plain.

Texture coordinates and normals have their own indices in an OBJ, so vertices are not split along seams.
"""

import re
from pathlib import Path

import numpy as np

from riginv.errors import InputError
from riginv.meshes.mesh_file import MeshFile, Points
from riginv.meshes.polygons import Polygons
from riginv.meshes.text_numbers import FORTRAN_NOTE, INFINITY_SIGN, mend_numbers, parse_numbers, reason_of

PLAIN = b"0123456789+-.eE \t\r\nv"
MENDED = PLAIN + b"na"
MENDABLE = PLAIN + b"nNaAiIfFtTyYdDqQsSjJoOrRbBxX()_#$" + INFINITY_SIGN  # in spellings of NaN, and in exponents
SPACES = bytes.maketrans(b"v", b" ")
UNUSUAL = {b"v": (b" v ",), b"f": (b" f ", b"fo ")}  # where a line of a keyword may not begin with it and a space
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
    """The mesh of an OBJ file; several objects are one mesh, in their order.

    Args:
        data: all bytes of the file.

    Raises:
        InputError: a line is not a vertex; the message names it.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        self.data = data = _plain_text(path, data)
        points = read_points(path, data)
        super().__init__(path, points.values, face_lines(data), points.notes)

    @property
    def objects(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(filter(None, map(_object_name, OBJECT.findall(self.data)))))

    def vertices_of(self, name: str) -> np.ndarray:
        lines = [*OBJECT.finditer(self.data)]
        ends = [line.start() for line in lines[1:]] + [len(self.data)]
        seen = len(VERTEX.findall(self.data[: lines[0].start()])) if lines else 0
        found = [np.zeros(0, np.int64)]
        for line, end in zip(lines, ends):
            count = len(VERTEX.findall(self.data[line.end() : end]))
            if _object_name(line[1]) == name:
                found.append(np.arange(seen, seen + count))
            seen += count
        return np.concatenate(found)

    def polygons(self) -> Polygons | None:
        return read_polygons(self.path, self.data)


def _object_name(text: bytes) -> str:
    return text.strip().decode("utf-8", "replace")


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
    """The vertices of an OBJ in their order; a coordinate of `nan`, in any spelling, is unknown.

    Raises:
        InputError: a line is not a vertex; the message names it.
    """
    start = 0 if data.startswith(b"v ") else data.find(b"\nv ") + 1
    last = data.rfind(b"\nv ") + 1
    if data[start : start + 2] == b"v ":
        end = data.find(b"\n", max(last, start))
        block = data[start : end + 1] if end >= 0 else data[start:] + b"\n"
        around = data[:start], data[start + len(block) :]
        if b"\\" not in data and not any(b"v" in part and _is_unusual(part, b"v") for part in around):
            found = _in_bulk(block)
            if found is not None:
                return found
    data = CONTINUED.sub(b" ", data) if b"\\" in data else data
    lines = _lines(data, b"v", VERTEX)  # of several objects, of any style
    found = _in_bulk(b"v " + b"\nv ".join(lines) + b"\n") if lines else None
    return found if found is not None else _line_by_line(path, data)


def _is_unusual(data: bytes, keyword: bytes) -> bool:
    return b"\t" in data or b"\\" in data or any(mark in data for mark in UNUSUAL[keyword])


def _lines(data: bytes, keyword: bytes, pattern: re.Pattern) -> list[bytes]:
    """The rest of each line after a keyword; a pattern that begins with plain letters is found ten times faster."""
    if _is_unusual(data, keyword):
        return pattern.findall(data)
    first = [data[2:].partition(b"\n")[0]] if data.startswith(keyword + b" ") else []
    return first + re.findall(rb"\n" + keyword + rb" ([^\n]*)", data)


def _in_bulk(block: bytes) -> Points | None:
    """The vertices of lines that are all `v` and equally many numbers; None where one is not."""
    fortran = 0
    if block.translate(None, PLAIN):
        if block.translate(None, MENDABLE):
            return None
        block, fortran = mend_numbers(block)
        if block.translate(None, MENDED):
            return None
    plain = np.frombuffer(block, np.uint8)
    marks = np.flatnonzero(plain == ord("v"))
    lines = np.flatnonzero(plain == ord("\n"))
    if len(marks) != len(lines) or (plain[marks[1:] - 1] != ord("\n")).any() or (plain[lines[:-1] + 1] != ord("v")).any():
        return None
    if (plain[marks + 1] > ord(" ")).any():  # v1 2 3
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
    """The bytes of an OBJ's faces, to compare files by: from the first to the last, if no vertices lie between."""
    start, last = data.find(b"\nf "), data.rfind(b"\nf ")
    if start >= 0 and not data.startswith(b"f"):
        end = data.find(b"\n", last + 1)
        block = data[start : end if end >= 0 else len(data)].rstrip()
        if b"\nv " not in block:
            return block
    return b"\n".join(_lines(data, b"f", FACE)) if b"f" in data else b""


def read_polygons(path: Path, data: bytes) -> Polygons | None:
    """The faces of an OBJ; None where it has none.

    Raises:
        InputError: a line is not a face; the message names it.
    """
    data = CONTINUED.sub(b" ", data) if b"\\" in data else data
    lines = _lines(data, b"f", FACE)
    if not lines:
        return None
    found = _polygons_in_bulk(b"\n".join(lines) + b"\n", len(lines))
    return found if found is not None else _polygons_line_by_line(path, data)


def _polygons_in_bulk(block: bytes, faces: int) -> Polygons | None:
    """The faces of lines of positive indices, with or without others after slashes; None where one is not."""
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


def obj_text(
    vertices: np.ndarray, faces: np.ndarray | list[list[int]], header: str = "# millimetres, y up\n", digits: str = ".5f"
) -> str:
    """A Wavefront OBJ.

    Args:
        vertices: `(vertex, 3)`.
        faces: the vertices of each, of any number.
        header: lines before the vertices.
        digits: format of coordinates.
    """
    lines = ["v " + " ".join(f"{value:{digits}}" for value in vertex) for vertex in vertices.tolist()]
    rows = faces.tolist() if isinstance(faces, np.ndarray) else faces
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in rows]
    return header + "\n".join(lines) + "\n"
