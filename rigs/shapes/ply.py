"""Stanford PLY, in text or binary: vertices and faces, as they stand."""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.errors import InputError

TYPES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d"},
}
ENDIAN = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
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


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices `(vertex, 3)`, the size of each face `(face,)`, and the vertex of each corner `(corner,)`, from 0.

    Raises:
        InputError: the file is no PLY, is truncated, or lacks coordinates.
    """
    content = path.read_bytes()
    endian, elements, start = _header(path, content)
    body = _Binary(content, start, endian) if endian else _Text(content[start:])
    vertices, sizes, corners = np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64)
    for element in elements:
        names = [prop.name for prop in element.properties]
        try:
            rows = body.rows(element)
            if element.name == "vertex":
                columns = [names.index(axis) for axis in "xyz"]
                vertices = np.array([[row[column] for column in columns] for row in rows], dtype=np.float64).reshape(-1, 3)
            elif element.name == "face":
                column = next(names.index(name) for name in FACE_LISTS if name in names)
                sizes = np.array([len(row[column]) for row in rows], dtype=np.int64)
                corners = np.array([corner for row in rows for corner in row[column]], dtype=np.float64).astype(np.int64)
        except (ValueError, IndexError, TypeError, StopIteration, struct.error):
            raise InputError(
                f"{path}: the header promises {element.count} of '{element.name}', and they cannot all be read: truncated, or "
                "no mesh of vertices with x, y, z and faces with vertex_indices; export it again"
            ) from None
    return vertices, sizes, corners


def _header(path: Path, content: bytes) -> tuple[str, list[Element], int]:
    """The byte order (empty for text), the elements, and where they start."""
    head, end, _ = content[:LONGEST_HEADER].partition(b"end_header")
    lines = [line.split() for line in head.decode("latin-1").splitlines()]
    elements: list[Element] = []
    try:
        if not end or lines[0] != ["ply"]:
            raise ValueError
        endian = ENDIAN[next(words[1] for words in lines if words[:1] == ["format"])]
        for words in lines:
            if words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2]), []))
            elif words[:2] == ["property", "list"]:
                elements[-1].properties.append(Property(words[4], TYPES[words[3]], TYPES[words[2]]))
            elif words[:1] == ["property"]:
                elements[-1].properties.append(Property(words[2], TYPES[words[1]]))
    except (ValueError, IndexError, KeyError, StopIteration):
        raise InputError(f"{path}: no PLY file: its header is truncated or damaged; export it again") from None
    return endian, elements, content.index(b"\n", len(head) + len(end)) + 1 if b"\n" in content[len(head) :] else len(content)


class _Text:
    """The body of a PLY in text: one line for each thing."""

    def __init__(self, body: bytes) -> None:
        self.lines = iter(body.decode("latin-1").splitlines())

    def rows(self, element: Element) -> list[list]:
        return [self._row(next(self.lines).split(), element) for _ in range(element.count)]

    def _row(self, words: list[str], element: Element) -> list:
        row, place = [], 0
        for prop in element.properties:
            first, count = (place + 1, int(words[place])) if prop.length else (place, 1)
            place = first + count
            values = [float(word) for word in words[first:place]]
            if len(values) != count:
                raise IndexError
            row.append(values if prop.length else values[0])
        return row


class _Binary:
    """The body of a binary PLY: numbers without gaps."""

    def __init__(self, content: bytes, start: int, endian: str) -> None:
        self.content, self.place, self.endian = content, start, endian

    def rows(self, element: Element) -> list[list]:
        if not any(prop.length for prop in element.properties):
            row = struct.Struct(self.endian + "".join(prop.kind for prop in element.properties))
            start, self.place = self.place, self.place + element.count * row.size
            if not start <= self.place <= len(self.content):
                raise IndexError
            return list(row.iter_unpack(self.content[start : self.place]))
        return [[self._value(prop) for prop in element.properties] for _ in range(element.count)]

    def _value(self, prop: Property) -> float | tuple:
        if not prop.length:
            return self._unpack(prop.kind)[0]
        return self._unpack(f"{self._unpack(prop.length)[0]}{prop.kind}")

    def _unpack(self, form: str) -> tuple:
        numbers = struct.Struct(self.endian + form)
        values = numbers.unpack_from(self.content, self.place)
        self.place += numbers.size
        return values
