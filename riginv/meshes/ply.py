"""Stanford PLY, text or binary: vertices are parsed in bulk, faces on demand, with any other elements before or between."""

from pathlib import Path

import numpy as np

from riginv.errors import InputError
from riginv.meshes.mesh_file import MeshFile, Points
from riginv.meshes.ply_body import BinaryBody, PlyBody, TextBody, TruncatedBodyError
from riginv.meshes.ply_header import Element, Header, read_header, row_type
from riginv.meshes.polygons import Polygons
from riginv.meshes.text_numbers import FORTRAN_NOTE, mend_numbers, parse_numbers, reason_of

FACE_LISTS = ("vertex_indices", "vertex_index")
FACES, STRIPS = "face", "tristrips"


class PlyMesh(MeshFile):
    """The mesh of a PLY file.

    Args:
        data: all bytes of the file.

    Raises:
        InputError: it is no PLY, is truncated, or lacks coordinates.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        self.header = header = read_header(path, data)
        number = _vertex_number(path, header)
        self.data, self.first, start = data[header.length :], 0, 0
        points = None
        if not header.order and number == 0:
            points, end = _text_points(path, header, self.data)
        if points is None:
            points, start, end = _points(path, header, self.data, number)
            rest = self.data[end:] if start == 0 else self.data[:start] + self.data[end:]
        else:
            self.data, self.first = self.data[end:], 1  # faces are read from what follows
            rest = self.data
        has_faces = any(element.name in (FACES, STRIPS) and element.count for element in header.elements)
        meaning = repr((header.order, header.elements)).encode()
        super().__init__(path, points.values, meaning + rest if has_faces else b"", points.notes)

    def polygons(self) -> Polygons | None:
        elements = self.header.elements[self.first :]
        wanted = next((one for name in (FACES, STRIPS) for one in elements if one.name == name and one.count), None)
        if wanted is None:
            return None
        column = next((wanted.index(name) for name in FACE_LISTS if wanted.index(name) >= 0), -1)
        if column < 0 or not wanted.properties[column].length:
            names = ", ".join(prop.name for prop in wanted.properties[:8]) or "nothing"
            raise InputError(
                f"{self.path}: its element '{wanted.name}' has {names}, expected a list {FACE_LISTS[0]}: export it again"
            )
        line = 1 + self.header.lines + sum(element.count for element in self.header.elements[: self.first])
        body, position, polygons = _body(self.path, self.header, self.data, line)[0], 0, None
        for element in elements:
            try:
                if element is wanted:
                    rows = body.rows(element, position)
                    corners, position = _whole(body.column(element, rows, column)), rows.end
                    sizes = rows.sizes[:, column]
                    polygons = Polygons(sizes, corners) if wanted.name == FACES else Polygons.strips(sizes, corners)
                else:
                    position = _after(body, element, position)
            except (TruncatedBodyError, OverflowError):
                raise _damaged(self.path, element) from None
        if not self.header.order and position != body.length:
            raise _damaged(self.path, wanted)
        return polygons


def _vertex_number(path: Path, header: Header) -> int:
    """The index of the element with the vertices."""
    number = next((number for number, element in enumerate(header.elements) if element.name == "vertex"), None)
    if number is None:
        raise InputError(f"{path}: no element 'vertex' in its header: export it again as a mesh")
    element = header.elements[number]
    columns = [element.index(axis) for axis in "xyz"]
    if min(columns) < 0 or any(element.properties[column].length for column in columns):
        names = [prop.name for prop in element.properties]
        raise InputError(f"{path}: vertices of {names[:8]}, expected x, y, z among them, a number each: export it again")
    return number


def _text_points(path: Path, header: Header, body: bytes) -> tuple[Points | None, int]:
    """The vertices, where they come first, one per line, and the offset behind them; None where they do not come first."""
    element = header.elements[0]
    ends = np.flatnonzero(np.frombuffer(body, np.uint8) == ord("\n"))
    if element.has_lists or not 0 < element.count <= len(ends) + 1:
        return None, 0
    stop = int(ends[element.count - 1]) + 1 if element.count <= len(ends) else len(body)
    values, notes = _numbers(path, header.lines + 1, body[:stop])
    if len(values) != element.count * len(element.properties):
        return None, 0
    table = values.reshape(element.count, -1)
    return Points(table[:, [element.index(axis) for axis in "xyz"]], notes), stop


def _points(path: Path, header: Header, data: bytes, number: int) -> tuple[Points, int, int]:
    """The vertices, and the offsets of their start and end (0 and 0 in text)."""
    body, notes = _body(path, header, data, header.lines + 1)
    position, element = 0, header.elements[number]
    for before in header.elements[:number]:
        try:
            position = _after(body, before, position)
        except (TruncatedBodyError, OverflowError):
            raise _damaged(path, before) from None
    try:
        end = _after(body, element, position)
        with np.errstate(invalid="ignore"):
            values = _coordinates(header, data, body, element, position)
    except (TruncatedBodyError, OverflowError, ValueError):
        raise _damaged(path, element) from None
    if header.order:
        return Points(values, notes), position, end
    _check_length(path, header, body, number, end)
    return Points(values, notes), 0, 0


def _coordinates(header: Header, data: bytes, body: PlyBody, element: Element, position: int) -> np.ndarray:
    columns = [element.index(axis) for axis in "xyz"]
    if header.order and not element.has_lists:
        table = np.frombuffer(data, row_type(element, header.order), element.count, position)
        return np.stack([table[str(column)].astype(np.float64) for column in columns], axis=1)
    rows = body.rows(element, position)
    return np.stack([body.column(element, rows, column) for column in columns], axis=1).astype(np.float64)


def _check_length(path: Path, header: Header, body: PlyBody, number: int, position: int) -> None:
    """Raises InputError where text has more or fewer numbers than its header states."""
    for element in header.elements[number + 1 :]:
        try:
            position = _after(body, element, position)
        except (TruncatedBodyError, OverflowError):
            raise _damaged(path, element) from None
    if position != body.length:
        raise _damaged(path, header.elements[number])


def _body(path: Path, header: Header, data: bytes, line: int) -> tuple[PlyBody, tuple[str, ...]]:
    if header.order:
        return BinaryBody(data, header.order), ()
    values, notes = _numbers(path, line, data)
    return TextBody(values), notes


def _after(body: PlyBody, element: Element, position: int) -> int:
    """The position after an element.

    Raises:
        TruncatedBodyError: it does not end within the body.
    """
    if element.has_lists:
        return body.rows(element, position).end
    end = position + element.count * sum(body.width(prop.kind) for prop in element.properties)
    if end > body.length:
        raise TruncatedBodyError
    return end


def _numbers(path: Path, line: int, text: bytes) -> tuple[np.ndarray, tuple[str, ...]]:
    """All numbers of a text that starts at a line of the file, and notes about what was repaired to read them."""
    values = parse_numbers(text)
    if values is not None:
        return values, ()
    mended, fortran = mend_numbers(text)
    values = parse_numbers(mended)
    if values is None:
        lines = text.split(b"\n")
        number = next((number for number, line in enumerate(lines) if parse_numbers(mend_numbers(line).text) is None), 0)
        found = lines[number].decode("utf-8", "replace").strip()[:60]
        reason = reason_of(lines[number]) or "truncated or damaged; export it again"
        raise InputError(f"{path}, line {line + number}: found {found!r}, expected numbers: {reason}")
    return values, (FORTRAN_NOTE,) if fortran else ()


def _whole(corners: np.ndarray) -> np.ndarray:
    """Corners as integers, -2 where one is not an integer."""
    if corners.dtype.kind == "f":
        fits = np.abs(corners) < 2**53
        corners = np.where(fits & (np.round(corners) == corners), corners, -2)
    return corners.astype(np.int64)


def _damaged(path: Path, element: Element) -> InputError:
    return InputError(
        f"{path}: the header promises {element.count} of '{element.name}', and they cannot all be read: truncated or damaged; "
        f"export it again"
    )
