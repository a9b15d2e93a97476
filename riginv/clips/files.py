"""Numbers that lie in a row in a file."""

from pathlib import Path

import numpy as np

from riginv.errors import InputError
from riginv.files import opened


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
