"""Ragged arrays, such as the corners of faces."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rigs.dna.format.cursor import U32, WORD, Cursor, Writer

COUNT_WORDS = U32.size // WORD.itemsize


class Ragged(NamedTuple):
    """Rows of different lengths.

    Attributes:
        values: of all rows, concatenated.
        sizes: number of values of each row, `(row,)`.
    """

    values: np.ndarray
    sizes: np.ndarray

    @classmethod
    def of(cls, rows: Sequence[Sequence[float]], dtype: type) -> "Ragged":
        """From a list of lists."""
        values = list(itertools.chain.from_iterable(rows))
        return cls(np.array(values, dtype=dtype), np.array([len(row) for row in rows], dtype=np.int64))

    @property
    def owners(self) -> np.ndarray:
        """Row index of each value."""
        return np.repeat(np.arange(len(self.sizes)), self.sizes)


def read_ragged(cursor: Cursor, dtypes: Sequence[np.dtype]) -> list[Ragged]:
    """A list whose elements are one list of each dtype; every list follows its count."""
    rows, data, begin = cursor.count(U32.size * len(dtypes)), cursor.data, cursor.position
    position, end, unpack = begin, cursor.end, U32.unpack_from
    sizes = np.zeros((rows, len(dtypes)), np.int64)
    widths = [dtype.itemsize for dtype in dtypes]
    for row in range(rows):
        for column, width in enumerate(widths):
            if position + U32.size <= end:
                size = unpack(data, position)[0]
                sizes[row, column] = size
                position += size * width
            position += U32.size
        if position > end:
            cursor.position = begin
            raise cursor.damaged(f"element {row:,} of the list of {rows:,} at byte {begin - 4:,} ends behind its end")
    cursor.position = position
    words = np.frombuffer(data, WORD, (position - begin) // WORD.itemsize, begin)
    return [
        Ragged(words[where].astype(WORD).view(dtype).astype(dtype.newbyteorder("=")), sizes[:, column])
        for column, (where, dtype) in enumerate(zip(_positions(sizes, dtypes)[1], dtypes))
    ]


def write_ragged(writer: Writer, columns: Sequence[Ragged], dtypes: Sequence[np.dtype]) -> None:
    """The bytes that `read_ragged` reads."""
    sizes = np.stack([column.sizes for column in columns], axis=1).astype(np.int64)
    writer.number(U32, len(sizes))
    counts, positions = _positions(sizes, dtypes)
    widths = np.array([dtype.itemsize // WORD.itemsize for dtype in dtypes])
    words = np.zeros(int((COUNT_WORDS + sizes * widths).sum()), WORD)
    words[(counts[..., None] + np.arange(COUNT_WORDS)).reshape(-1)] = sizes.reshape(-1).astype(">u4").view(WORD)
    for column, where, dtype in zip(columns, positions, dtypes):
        words[where] = column.values.astype(dtype).view(WORD)
    writer.data += words.tobytes()


def _positions(sizes: np.ndarray, dtypes: Sequence[np.dtype]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Positions in words of the count of each list `(row, column)`, and of the values of each column."""
    widths = np.array([dtype.itemsize // WORD.itemsize for dtype in dtypes])
    lengths = COUNT_WORDS + sizes * widths
    starts = (np.cumsum(lengths) - lengths.reshape(-1)).reshape(sizes.shape)
    positions = []
    for column, width in enumerate(widths):
        words = sizes[:, column] * width
        first = np.repeat(starts[:, column] + COUNT_WORDS - (np.cumsum(words) - words), words)
        positions.append(first + np.arange(len(first)))
    return starts, positions
