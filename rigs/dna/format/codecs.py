"""Binary codecs of the fields of layers. A layer is a dataclass whose annotations name the codecs."""

import dataclasses
import struct
import typing
from abc import ABC, abstractmethod
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from rigs.dna.format.cursor import U8, U16, U32, Cursor, Writer
from rigs.dna.format.ragged import Ragged, read_ragged, write_ragged


class Codec(ABC):
    """Reads and writes one type.

    Attributes:
        least: minimum number of bytes of a value.
    """

    least: int

    @abstractmethod
    def read(self, cursor: Cursor) -> Any:
        """The value at the cursor."""

    @abstractmethod
    def write(self, writer: Writer, value: Any) -> None:
        """Append a value."""


class Number(Codec):
    """A whole number."""

    def __init__(self, form: struct.Struct) -> None:
        self.form, self.least = form, form.size

    def read(self, cursor: Cursor) -> int:
        return cursor.number(self.form)

    def write(self, writer: Writer, value: int) -> None:
        writer.number(self.form, value)


class Scalar(Codec):
    """A float32, kept as one: Python's floats would change the bits of some NaNs."""

    dtype = np.dtype(">f4")
    least = dtype.itemsize

    def read(self, cursor: Cursor) -> np.float32:
        return cursor.array(self.dtype, 1)[0]

    def write(self, writer: Writer, value: float) -> None:
        writer.array(self.dtype, np.array([value]))


class OptionalByte(Codec):
    """A byte at the end of a layer of later versions; None where the layer ends before it."""

    least = 0

    def read(self, cursor: Cursor) -> int | None:
        return cursor.number(U8) if cursor.remaining else None

    def write(self, writer: Writer, value: int | None) -> None:
        if value is not None:
            writer.number(U8, value)


class Text(Codec):
    """A string; bytes that are not UTF-8 are kept as lone surrogates."""

    least = U32.size

    def read(self, cursor: Cursor) -> str:
        size = cursor.count(1)
        start = cursor.take(size)
        return cursor.data[start : start + size].decode("utf-8", "surrogateescape")

    def write(self, writer: Writer, value: str) -> None:
        content = value.encode("utf-8", "surrogateescape")
        writer.number(U32, len(content))
        writer.data += content


class Array(Codec):
    """A list of numbers, as a NumPy array."""

    least = U32.size

    def __init__(self, dtype: str) -> None:
        self.dtype = np.dtype(dtype)

    def read(self, cursor: Cursor) -> np.ndarray:
        return cursor.array(self.dtype, cursor.count(self.dtype.itemsize))

    def write(self, writer: Writer, value: np.ndarray) -> None:
        writer.number(U32, len(value))
        writer.array(self.dtype, value)


class RaggedRows(Codec):
    """A list of lists of numbers, or of pairs of such lists: one `Ragged`, or one for each of the pair."""

    least = U32.size

    def __init__(self, *dtypes: str) -> None:
        self.dtypes = [np.dtype(dtype) for dtype in dtypes]

    def read(self, cursor: Cursor) -> Ragged | tuple[Ragged, ...]:
        found = read_ragged(cursor, self.dtypes)
        return found[0] if len(found) == 1 else tuple(found)

    def write(self, writer: Writer, value: Ragged | tuple[Ragged, ...]) -> None:
        write_ragged(writer, [value] if isinstance(value, Ragged) else value, self.dtypes)


class Items(Codec):
    """A list of anything."""

    least = U32.size

    def __init__(self, item: Codec) -> None:
        self.item = item

    def read(self, cursor: Cursor) -> tuple:
        return tuple(self.item.read(cursor) for _ in range(cursor.count(self.item.least)))

    def write(self, writer: Writer, value: tuple) -> None:
        writer.number(U32, len(value))
        for item in value:
            self.item.write(writer, item)


class Record(Codec):
    """A dataclass, field after field.

    Args:
        sized: whether it is preceded by its size, or in version 2.1 by the position of its end.
    """

    def __init__(self, kind: type, sized: bool = False) -> None:
        self.kind, self.sized = kind, sized
        hints = get_type_hints(kind, include_extras=True)
        self.fields = {field.name: codec_of(hints[field.name]) for field in dataclasses.fields(kind)}
        self.least = sum(codec.least for codec in self.fields.values()) + (U32.size if sized else 0)

    def read(self, cursor: Cursor) -> Any:
        if not self.sized:
            return self.kind(**{name: codec.read(cursor) for name, codec in self.fields.items()})
        size = cursor.number(U32)
        end = size if cursor.absolute_sizes else cursor.position + size
        value = self.kind(**{name: codec.read(cursor) for name, codec in self.fields.items()})
        if cursor.position != end:
            raise cursor.damaged(f"a {self.kind.__name__} ends at byte {cursor.position:,}, by its size at byte {end:,}")
        return value

    def write(self, writer: Writer, value: Any) -> None:
        reserved = writer.reserve() if self.sized else None
        begin = writer.position
        for name, codec in self.fields.items():
            codec.write(writer, getattr(value, name))
        if reserved is not None:
            writer.fill(reserved, writer.position if writer.absolute_sizes else writer.position - begin)


def codec_of(hint: Any) -> Codec:
    """Codec of an annotation: its own, or that of a dataclass or a tuple."""
    if get_origin(hint) is Annotated:
        inner, *marks = get_args(hint)
        codec = next((mark for mark in marks if isinstance(mark, Codec)), None)
        return codec or Record(inner, sized=True)  # Annotated[Mesh, SIZED]
    if get_origin(hint) is tuple:
        return Items(codec_of(get_args(hint)[0]))
    return Record(hint)


SIZED = "sized"
Kind = typing.TypeVar("Kind")
Sized = Annotated[Kind, SIZED]

Byte = Annotated[int | None, OptionalByte()]
Short = Annotated[int, Number(U16)]
Long = Annotated[int, Number(U32)]
Float = Annotated[float, Scalar()]
String = Annotated[str, Text()]
Shorts = Annotated[np.ndarray, Array(">u2")]
Longs = Annotated[np.ndarray, Array(">u4")]
Floats = Annotated[np.ndarray, Array(">f4")]
Corners = Annotated[Ragged, RaggedRows(">u4")]
Influences = Annotated[tuple[Ragged, Ragged], RaggedRows(">f4", ">u2")]
