"""Shapes as arrays of deltas: `.npy` (one shape), `.npz` and `.safetensors` (a table from names to shapes)."""

import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open

from riginv.errors import InputError
from riginv.runs.array_files import check_npy, check_npz

# Raised by numpy, zipfile and safetensors for damaged files; RuntimeError: encrypted or unsupported zip files.
DAMAGE: tuple[type[Exception], ...] = (OSError, EOFError, ValueError, KeyError, MemoryError, RuntimeError, SyntaxError)
DAMAGE += (tokenize.TokenError, zlib.error, zipfile.BadZipFile, SafetensorError)


@contextmanager
def _open_npy(path: Path) -> Iterator[tuple[list[str], Callable[[str], np.ndarray]]]:
    check_npy(path)
    yield [path.stem], lambda name: np.load(path, allow_pickle=False)


@contextmanager
def _open_npz(path: Path) -> Iterator[tuple[list[str], Callable[[str], np.ndarray]]]:
    check_npz(path)
    with np.load(path, allow_pickle=False) as table:
        yield list(table.files), lambda name: table[name]


@contextmanager
def _open_safetensors(path: Path) -> Iterator[tuple[list[str], Callable[[str], np.ndarray]]]:
    with safe_open(path, framework="pt") as table:
        yield list(table.keys()), lambda name: table.get_tensor(name).double().numpy()


READERS = {".npy": _open_npy, ".npz": _open_npz, ".safetensors": _open_safetensors}


def names_in(path: Path) -> list[str]:
    """Names of the shapes in a file: those of a table, else the file's stem.

    Raises:
        InputError: the table cannot be read.
    """
    if path.suffix.lower() not in READERS:
        return [path.stem]
    with _explained(path), READERS[path.suffix.lower()](path) as (names, _):
        return names


def read_deltas(path: Path, name: str, vertex_count: int) -> np.ndarray:
    """Deltas `(vertex, 3)` of a shape, in the file's unit.

    Raises:
        InputError: the file is damaged, or the array is not `(vertex, 3)` finite numbers.
    """
    with _explained(path), READERS[path.suffix.lower()](path) as (_, read):
        found = np.asarray(read(name))
    if found.shape != (vertex_count, 3) or found.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: '{name}' is {found.dtype} of shape {found.shape}, expected numbers of shape ({vertex_count}, 3), a row "
            "for each vertex of the neutral; if it is no shape, leave it out with rig.exclude"
        )
    if not np.isfinite(found).all():
        raise InputError(f"{path}: the deltas '{name}' hold NaN or infinite numbers; export them again")
    return found.astype(np.float64)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except DAMAGE as error:
        if isinstance(error, InputError):
            raise
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: cannot be read as arrays of deltas: {reason}; truncated, or of another format than its suffix"
        ) from None
