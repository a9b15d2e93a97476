"""Reading and writing the bytes of a DNA file, with every count checked against the remaining bytes."""

import struct

import numpy as np

from riginv.errors import InputError

WORD = np.dtype(">u2")  # the smallest unit of lists; everything between two lists is a multiple of it


class Cursor:
    """A position in a file's bytes.

    Args:
        where: the file, for messages.
        data: all bytes of the file.
        start, end: readable range.
        part: what is read, such as a layer, for messages.
        absolute_sizes: whether blocks start with the position of their end instead of their size, as in version 2.1.
    """

    def __init__(self, where: str, data: bytes, start: int, end: int, part: str, absolute_sizes: bool = False) -> None:
        self.where, self.data, self.position, self.end, self.part = where, data, start, end, part
        self.absolute_sizes = absolute_sizes

    @property
    def remaining(self) -> int:
        return self.end - self.position

    def damaged(self, found: str) -> InputError:
        """The error for invalid bytes."""
        return InputError(f"{self.where}: {self.part}: {found}: the file is damaged or truncated; export or copy it again")

    def take(self, size: int) -> int:
        """Skip `size` bytes and return their position."""
        if size > self.remaining:
            raise self.damaged(f"{size:,} bytes are needed at byte {self.position:,}, only {self.remaining:,} are left")
        start = self.position
        self.position += size
        return start

    def number(self, form: struct.Struct) -> int:
        return form.unpack_from(self.data, self.take(form.size))[0]

    def count(self, least: int) -> int:
        """Count of a list whose elements have at least `least` bytes each."""
        count = self.number(U32)
        if count * least > self.remaining:
            raise self.damaged(
                f"a list of {count:,} elements at byte {self.position - 4:,} does not fit into the {self.remaining:,} bytes "
                f"after it"
            )
        return count

    def array(self, dtype: np.dtype, count: int) -> np.ndarray:
        start = self.take(count * dtype.itemsize)
        return np.frombuffer(self.data, dtype, count, start).astype(dtype.newbyteorder("="))


class Writer:
    """Bytes that grow.

    Args:
        absolute_sizes: as `Cursor`.
    """

    def __init__(self, absolute_sizes: bool = False) -> None:
        self.data = bytearray()
        self.absolute_sizes = absolute_sizes

    @property
    def position(self) -> int:
        return len(self.data)

    def number(self, form: struct.Struct, value: int) -> None:
        self.data += form.pack(value)

    def array(self, dtype: np.dtype, values: np.ndarray) -> None:
        self.data += np.asarray(values).astype(dtype).tobytes()

    def reserve(self) -> int:
        """Reserve a u32 and return its position."""
        self.number(U32, 0)
        return len(self.data) - U32.size

    def fill(self, position: int, value: int) -> None:
        """Write a reserved u32."""
        U32.pack_into(self.data, position, value)


U8, U16, U32 = (struct.Struct(f">{letter}") for letter in "BHI")
