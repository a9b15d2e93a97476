"""The body of a PLY after its header: rows of numbers, text or binary, some with lists.

Positions count bytes in a binary body and numbers in a text body.
"""

import struct
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from riginv.meshes.ply_header import Element, Property

CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f4": "f", "f8": "d"}


class TruncatedBodyError(ValueError):
    """An element is longer than the body, or a list has an impossible length."""


class Rows(NamedTuple):
    """The positions of an element's rows.

    Attributes:
        starts: the position of each property in each row, `(row, property)`; of a list that of its first number.
        sizes: the length of each list, `(row, property)`; 1 for other properties.
        end: the position after the last row.
    """

    starts: np.ndarray
    sizes: np.ndarray
    end: int


class PlyBody(ABC):
    """The numbers of all elements.

    Attributes:
        length: the number of positions.
    """

    length: int

    @abstractmethod
    def width(self, kind: str) -> int:
        """The positions that a number of a type takes."""

    @abstractmethod
    def take(self, kind: str, positions: np.ndarray) -> np.ndarray:
        """The numbers `(number,)` at positions."""

    @abstractmethod
    def number(self, kind: str, position: int) -> float:
        """The number at a position."""

    def rows(self, element: Element, start: int) -> Rows:
        """The rows of an element that starts at a position.

        Raises:
            TruncatedBodyError: the body ends before them.
        """
        least = sum(self.width(prop.length or prop.kind) for prop in element.properties)
        if element.count * least > self.length - start:
            raise TruncatedBodyError
        if not least or not element.count:
            empty = np.zeros((0, len(element.properties)), np.int64)
            return Rows(empty, empty, start)
        found = self._equal_rows(element, start) if self.length > start else None
        return found or self._different_rows(element, start)

    def _equal_rows(self, element: Element, start: int) -> Rows | None:
        """The rows, if all lists are as long as in the first row; else None."""
        offsets, sizes, length = self._row(element.properties, start)
        if length * element.count > self.length - start:
            return None
        starts = length * np.arange(element.count)[:, None] + np.array(offsets)
        for column, prop in enumerate(element.properties):
            if prop.length:
                lengths = self.take(prop.length, starts[:, column] - self.width(prop.length))
                if (lengths != sizes[column]).any():
                    return None
        return Rows(starts, np.tile(np.array(sizes), (element.count, 1)), start + length * element.count)

    def _different_rows(self, element: Element, start: int) -> Rows:
        offsets, sizes, position = [], [], start
        for _ in range(element.count):
            row_offsets, row_sizes, length = self._row(element.properties, position)
            offsets.append(row_offsets)
            sizes.append(row_sizes)
            position += length
        if position > self.length:
            raise TruncatedBodyError
        return Rows(np.array(offsets), np.array(sizes), position)

    def _row(self, properties: list[Property], start: int) -> tuple[list[int], list[int], int]:
        """The position of each property of one row, its size, and the row's length."""
        offsets, sizes, position = [], [], start
        for prop in properties:
            size = 1.0
            if prop.length:
                if position >= self.length:
                    raise TruncatedBodyError
                size = self.number(prop.length, position)
                position += self.width(prop.length)
                if not 0 <= size <= self.length - position or size != int(size):
                    raise TruncatedBodyError
            offsets.append(position)
            sizes.append(int(size))
            position += int(size) * self.width(prop.kind)
        return offsets, sizes, position - start

    def column(self, element: Element, rows: Rows, column: int) -> np.ndarray:
        """The numbers of a property, `(row,)`; of a list all of them, row by row."""
        kind = element.properties[column].kind
        starts, sizes = rows.starts[:, column], rows.sizes[:, column]
        within = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        return self.take(kind, np.repeat(starts, sizes) + within * self.width(kind))


class BinaryBody(PlyBody):
    """A binary body."""

    def __init__(self, data: bytes, order: str) -> None:
        self.data, self.bytes, self.order, self.length = data, np.frombuffer(data, np.uint8), order, len(data)
        self.structs = {kind: struct.Struct(order + code) for kind, code in CODES.items()}

    def width(self, kind: str) -> int:
        return self.structs[kind].size

    def take(self, kind: str, positions: np.ndarray) -> np.ndarray:
        dtype = np.dtype(self.order + kind)
        if len(positions) and int(positions.max()) + dtype.itemsize > self.length:
            raise TruncatedBodyError
        found = np.empty((len(positions), dtype.itemsize), np.uint8)
        for byte in range(dtype.itemsize):
            found[:, byte] = self.bytes[positions + byte]
        return found.reshape(-1).view(dtype)

    def number(self, kind: str, position: int) -> float:
        if position + self.width(kind) > self.length:
            raise TruncatedBodyError
        return self.structs[kind].unpack_from(self.data, position)[0]


class TextBody(PlyBody):
    """A text body: numbers separated by white space."""

    def __init__(self, numbers: np.ndarray) -> None:
        self.numbers, self.length = numbers, len(numbers)

    def width(self, kind: str) -> int:
        return 1

    def take(self, kind: str, positions: np.ndarray) -> np.ndarray:
        if len(positions) and int(positions.max()) >= self.length:
            raise TruncatedBodyError
        return self.numbers[positions]

    def number(self, kind: str, position: int) -> float:
        return float(self.numbers[position])
