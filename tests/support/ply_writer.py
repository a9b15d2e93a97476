"""A writer of PLY for tests: any elements in any order, in text or binary."""

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

FORMS = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d"},
}


class Written(NamedTuple):
    """An element: its name, its properties as `float x` or `list uchar int vertex_indices`, and a value or list for each."""

    name: str
    properties: Sequence[str]
    rows: Sequence[Sequence]


def ply(elements: Sequence[Written], form: str = "ascii", line: str = "\n", more: Sequence[str] = ()) -> bytes:
    """The bytes of a PLY.

    Args:
        form: `ascii`, `binary_little_endian` or `binary_big_endian`.
        line: what ends a line of the header, and of text.
        more: lines for the header, such as comments.
    """
    header = ["ply", f"format {form} 1.0", *more]
    for element in elements:
        header += [f"element {element.name} {len(element.rows)}", *(f"property {prop}" for prop in element.properties)]
    head = line.join([*header, "end_header", ""]).encode()
    pack = _text if form == "ascii" else _packer("<" if "little" in form else ">")
    rows = [
        b"".join(pack(prop.split(), value) for prop, value in zip(element.properties, row))
        for element in elements
        for row in element.rows
    ]
    return head + (line.encode().join(rows) + line.encode() if form == "ascii" else b"".join(rows))


def _number(kind: str, value: float) -> float:
    return float(value) if FORMS[kind] in "fd" else int(value)


def _text(prop: Sequence[str], value: object) -> bytes:
    numbers = [len(value), *value] if prop[0] == "list" else [value]
    return b"".join(f"{_number(prop[-2], number)!r} ".encode() for number in numbers).replace(b".0 ", b" ")


def _packer(order: str) -> Callable[[Sequence[str], object], bytes]:
    def pack(prop: Sequence[str], value: object) -> bytes:
        if prop[0] == "list":
            return struct.pack(order + FORMS[prop[1]], len(value)) + struct.pack(f"{order}{len(value)}{FORMS[prop[2]]}", *value)
        return struct.pack(order + FORMS[prop[0]], _number(prop[0], value))

    return pack


def vertices(points: Sequence, properties: Sequence[str] = ("float x", "float y", "float z"), **more: object) -> Written:
    """The element `vertex`; x, y and z where properties name them, what `more` says or 7 for the others."""
    names = [prop.split()[-1] for prop in properties]
    at = {"x": 0, "y": 1, "z": 2}
    return Written(
        "vertex", properties, [[point[at[name]] if name in at else more.get(name, 7) for name in names] for point in points]
    )


def faces(polygons: Sequence, properties: Sequence[str] = ("list uchar int vertex_indices",), **more: object) -> Written:
    """The element `face`; the corners where a property is named so, what `more` says or 7 for the others."""
    names = [prop.split()[-1] for prop in properties]
    lists = [[int(corner) for corner in face] for face in polygons]
    return Written(
        "face", properties, [[face if name.startswith("vertex_ind") else more.get(name, 7) for name in names] for face in lists]
    )
