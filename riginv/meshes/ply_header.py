"""The header of a PLY: its elements, their numbers and properties."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.errors import InputError

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"},
}
BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
IGNORED = ("ply", "format", "comment", "obj_info")
LONGEST = 1 << 16
END = re.compile(rb"^end_header[ \t]*", re.MULTILINE)


class Property(NamedTuple):
    """One property of an element: its name, its type, and the type of its length if it is a list."""

    name: str
    kind: str
    length: str = ""


@dataclass(frozen=True)
class Element:
    """An element of the file, such as `vertex`: its name, the number of its rows, and their properties."""

    name: str
    count: int
    properties: list[Property]

    @property
    def has_lists(self) -> bool:
        return any(prop.length for prop in self.properties)

    def index(self, name: str) -> int:
        """The index of the property of a name; -1 without one, or with more than one."""
        found = [number for number, prop in enumerate(self.properties) if prop.name == name]
        return found[0] if len(found) == 1 else -1


class Header(NamedTuple):
    """A parsed header.

    Attributes:
        order: byte order, `<` or `>`; empty for text.
        elements: in the file's order.
        length: of the header, bytes.
        lines: of the header.
    """

    order: str
    elements: list[Element]
    length: int
    lines: int


def read_header(path: Path, data: bytes) -> Header:
    """Read the header of a PLY, with any line ends.

    Raises:
        InputError: the file is not a PLY, or its header is truncated or damaged.
    """
    start = data[:LONGEST]
    break_ = b"\r" if start[:4] == b"ply\r" and start[4:5] != b"\n" else b"\n"
    end = END.search(start if break_ == b"\n" else start.replace(b"\r", b"\n"))
    after = re.compile(rb"\r?\n|\Z" if break_ == b"\n" else rb"\r|\Z").match(data, end.end()) if end else None
    lines = [line.split() for line in start[: end.start()].decode("latin-1").splitlines()] if end else []
    try:
        if after is None or lines[0] != ["ply"]:
            raise ValueError
        order = BYTE_ORDERS[next(words[1] for words in lines if words[:1] == ["format"])]
        elements = _elements(lines)
    except (ValueError, IndexError, KeyError, StopIteration):
        raise InputError(f"{path}: no PLY file: its header is truncated or damaged; export it again") from None
    return Header(order, elements, after.end(), len(lines) + 1)


def _elements(lines: list[list[str]]) -> list[Element]:
    elements: list[Element] = []
    for words in lines:
        if words[:1] == ["element"]:
            elements.append(Element(words[1], int(words[2]), []))
            if elements[-1].count < 0:
                raise ValueError
        elif words[:2] == ["property", "list"]:
            elements[-1].properties.append(Property(words[4], TYPES[words[3]], TYPES[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1].properties.append(Property(words[2], TYPES[words[1]]))
        elif words and words[0] not in IGNORED:  # perhaps a damaged property
            raise ValueError
    if any(element.count and not element.properties for element in elements):
        raise ValueError
    return elements


def row_type(element: Element, order: str) -> np.dtype:
    """The type of a row of a binary element without lists."""
    return np.dtype([(f"{number}", order + prop.kind) for number, prop in enumerate(element.properties)])
