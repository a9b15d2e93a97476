"""Opening what a user named, so that a missing or unreadable file ends in a sentence."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from riginv.errors import InputError
from riginv.files import check_regular


@contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """A file open for reading bytes.

    Raises:
        InputError: it is not there, or cannot be read.
    """
    check_regular(path)
    try:
        with path.open("rb") as file:
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; clip=PATH names a clip") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None


def read_bytes(path: Path) -> bytes:
    """All bytes of a file.

    Raises:
        InputError: it is not there, or cannot be read.
    """
    with opened(path) as file:
        return file.read()


def read_numbers(path: Path, dtype: np.dtype, shape: tuple[int, ...], offset: int) -> np.ndarray:
    """Numbers that lie in a row in a file, from a byte on.

    Raises:
        InputError: the file is shorter than that, or cannot be read.
    """
    values = np.empty(shape, dtype)
    with opened(path) as file:
        file.seek(offset)
        found = file.readinto(memoryview(values).cast("B")) if values.size else 0
    if found < values.nbytes:
        raise InputError(f"{path}: it ends {values.nbytes - found} bytes early: truncated; copy it or export it again")
    return values
