"""Stanford PLY, in text or binary: the vertices in bulk, the faces once they are asked for."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.obj_text import parse_numbers
from riginv.clips.sequence import Polygons
from riginv.errors import InputError

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8"},
}
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
FACE_LISTS = ("vertex_indices", "vertex_index")
LONGEST_HEADER = 1 << 16


class Property(NamedTuple):
    """One property of an element: its name, its type, and where it is a list, the type of its length."""

    name: str
    kind: str
    length: str = ""


class Element(NamedTuple):
    """A kind of thing in the file, such as `vertex`, how many there are, and what each consists of."""

    name: str
    count: int
    properties: list[Property]

    @property
    def has_lists(self) -> bool:
        return any(prop.length for prop in self.properties)


class PlyMesh(NamedTuple):
    """A mesh in a PLY file.

    Attributes:
        path: of the file.
        points: `(vertex, 3)` float32.
        face_bytes: what of the file holds its faces.
        faces: the element that describes them, or None.
        order: of bytes; empty for text.
    """

    path: Path
    points: np.ndarray
    face_bytes: bytes
    faces: Element | None
    order: str

    def polygons(self) -> Polygons | None:
        """The faces; None where there are none.

        Raises:
            InputError: they are truncated or damaged.
        """
        if self.faces is None or not self.faces.count:
            return None
        try:
            lists = _binary_lists(self.face_bytes, self.faces, self.order) if self.order else _text_lists(*self[2:4])
            sizes = np.array([len(one) for one in lists], np.int64)
            return Polygons(sizes, np.concatenate(lists).astype(np.int64))
        except (ValueError, IndexError, StopIteration, OverflowError):
            raise _damaged(self.path, self.faces) from None


def read_ply(path: Path, data: bytes) -> PlyMesh:
    """Read the vertices of a PLY.

    Raises:
        InputError: the file is no PLY, is truncated, or lacks coordinates.
    """
    order, elements, body = _header(path, data)
    place = next((number for number, element in enumerate(elements) if element.name == "vertex"), None)
    if place is None:
        raise InputError(f"{path}: no element 'vertex' in its header: export it again as a mesh")
    for element in elements[:place]:
        if element.has_lists or not order:
            raise InputError(f"{path}: '{element.name}' stands before the vertices, expected these first: export it again")
        body = body[element.count * _row(element, order).itemsize :]
    element = elements[place]
    names = [prop.name for prop in element.properties]
    if element.has_lists or len(set(names)) != len(names) or not set("xyz") <= set(names):
        raise InputError(f"{path}: vertices of {names[:8]}, expected numbers, with x, y and z among them: export it again")
    points, rest = (_binary_points if order else _text_points)(path, element, body, order)
    after = elements[place + 1 :]
    faces = after[0] if after and after[0].name == "face" else None
    return PlyMesh(path, points, rest if faces else b"", faces, order)


def _header(path: Path, data: bytes) -> tuple[str, list[Element], bytes]:
    """The byte order (empty for text), the elements, and what follows the header."""
    head, end, _ = data[:LONGEST_HEADER].partition(b"end_header")
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    elements: list[Element] = []
    try:
        if not end or lines[0] != ["ply"]:
            raise ValueError
        order = BYTE_ORDERS[next(words[1] for words in lines if words[:1] == ["format"])]
        for words in lines:
            if words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1].properties.append(Property(words[4], TYPES[words[3]], TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1].properties.append(Property(words[2], TYPES[words[1]]))
        if any(element.count < 0 for element in elements):
            raise ValueError
    except (ValueError, IndexError, KeyError, StopIteration):
        raise InputError(f"{path}: no PLY file: its header is truncated or damaged; export it again") from None
    body = data[len(head) + len(end) :]
    return order, elements, body[body.find(b"\n") + 1 :] if b"\n" in body[:3] else b""


def _row(element: Element, order: str) -> np.dtype:
    return np.dtype([(f"{number}", order + prop.kind) for number, prop in enumerate(element.properties)])


def _binary_points(path: Path, element: Element, body: bytes, order: str) -> tuple[np.ndarray, bytes]:
    row = _row(element, order)
    size = element.count * row.itemsize
    if len(body) < size:
        raise _damaged(path, element)
    table = np.frombuffer(body, row, element.count)
    columns = [table[str(_place(element, axis))] for axis in "xyz"]
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack([column.astype(np.float32) for column in columns], axis=1), body[size:]


def _text_points(path: Path, element: Element, body: bytes, order: str) -> tuple[np.ndarray, bytes]:
    ends = np.flatnonzero(np.frombuffer(body, np.uint8) == ord("\n"))
    if element.count > len(ends) + 1 or not element.count:
        raise _damaged(path, element)
    stop = int(ends[element.count - 1]) + 1 if element.count <= len(ends) else len(body)
    values = parse_numbers(body[:stop])
    if values is None or len(values) != element.count * len(element.properties):
        raise _damaged(path, element)
    table = values.reshape(element.count, -1)[:, [_place(element, axis) for axis in "xyz"]]
    with np.errstate(over="ignore", invalid="ignore"):
        return table.astype(np.float32), body[stop:]


def _place(element: Element, name: str) -> int:
    return next(number for number, prop in enumerate(element.properties) if prop.name == name)


def _list_of(element: Element) -> int:
    return next(number for number, prop in enumerate(element.properties) if prop.length and prop.name in FACE_LISTS)


def _binary_lists(data: bytes, element: Element, order: str) -> list[np.ndarray]:
    wanted, place, found = _list_of(element), 0, []
    kinds = [
        (np.dtype(order + prop.kind), np.dtype(order + prop.length) if prop.length else None) for prop in element.properties
    ]
    for _ in range(element.count):
        for number, (kind, length) in enumerate(kinds):
            count = 1
            if length is not None:
                count = int(np.frombuffer(data, length, 1, place)[0])
                place += length.itemsize
            if count < 0:
                raise ValueError
            if number == wanted:
                found.append(np.frombuffer(data, kind, count, place) if count else np.zeros(0, kind))
            place += count * kind.itemsize
    return found


def _text_lists(data: bytes, element: Element) -> list[np.ndarray]:
    wanted, found = _list_of(element), []
    lines = iter(data.decode("latin-1").splitlines())
    for _ in range(element.count):
        words, place = next(lines).split(), 0
        for number, prop in enumerate(element.properties):
            count = int(words[place]) if prop.length else 1
            place += 1 if prop.length else 0
            if not 0 <= count <= len(words) - place:
                raise ValueError
            if number == wanted:
                found.append(np.array([int(word) for word in words[place : place + count]], np.int64))
            place += count
    return found


def _damaged(path: Path, element: Element) -> InputError:
    return InputError(
        f"{path}: the header promises {element.count} of '{element.name}', and they cannot all be read: truncated or damaged; "
        f"export it again"
    )
