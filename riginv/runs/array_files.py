"""Checked reading of untrusted array files: numbers and text, no Python objects, no more values than the file can hold.

NumPy, zarr and numcodecs read what a header promises; these checks come before they do.
"""

import io
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, NamedTuple

import numpy as np

from riginv.errors import InputError, in_short
from riginv.runs.files import check_regular

LONGEST_HEADER = 10_000  # bytes; NumPy's own bound for headers that are not trusted
RATIO = 200  # numbers of a rig do not pack better; what claims to is a bomb
SPARE = 1 << 28  # bytes that any file may claim
PLAIN = "biufcUS"  # kinds of dtypes
CODECS = {  # of zarr: those that compute, none that makes objects (numcodecs has one that unpickles)
    *("bytes", "endian", "transpose", "sharding_indexed", "crc32c", "vlen-utf8", "vlen-bytes"),
    *("blosc", "gzip", "zlib", "zstd", "lz4", "bz2", "lzma", "shuffle", "delta", "bitround", "quantize", "astype"),
    *("fixedscaleoffset", "packbits", "crc32", "adler32", "fletcher32"),
}
BROKEN = (ValueError, KeyError, TypeError, SyntaxError, RecursionError, OverflowError, EOFError, TokenError, MemoryError)
DAMAGED_ZIP = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, struct.error)


def check_npy(path: Path) -> None:
    """Raises InputError where an .npy is truncated, or holds other values than numbers and text.

    Raises:
        InputError: its header is damaged, or promises Python objects, or more than the file has.
        OSError: it cannot be opened.
    """
    check_regular(path)
    with path.open("rb") as file:
        _check_header(str(path), file, path.stat().st_size, alone=True)


def load_numbers(path: Path, key: str, expected: str, parse: Callable[[str], Sequence[float]]) -> np.ndarray:
    """The array in an .npy, or the numbers in a text file.

    Args:
        key: of the config, that names the file.
        expected: what should be in it, for the message.
        parse: a text to numbers; raises ValueError.

    Raises:
        InputError: it is missing or cannot be read.
    """
    try:
        if path.suffix == ".npy":
            check_npy(path)
            return np.load(path, allow_pickle=False)
        return np.array(parse(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, named by {key}") from None
    except (OSError, ValueError, EOFError, OverflowError, RecursionError) as error:
        raise InputError(f"{path}: {expected}; it cannot be read: {str(error)[:120]}") from None


def whole_numbers(text: str) -> list[int]:
    """The whole numbers in a text, between blanks or commas."""
    return [int(word) for word in text.replace(",", " ").split()]


def check_npz(path: Path) -> None:
    """Raises InputError where a member of an .npz is implausibly large for the file's size; NumPy refuses Python objects.

    Raises:
        InputError: it is no zip, or a member is damaged, encrypted, or promises far more than there is.
        OSError: it cannot be opened.
    """
    check_regular(path)
    most = RATIO * path.stat().st_size + SPARE
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if not member.filename.endswith(".npy"):
                    continue
                if member.file_size > most:
                    raise InputError(f"{path}: {member.filename!r:.80} would be {member.file_size:,} bytes: a bomb, or damaged")
                with archive.open(member) as file:
                    start = file.read(LONGEST_HEADER + 20)
                _check_header(f"{path}, {member.filename}", io.BytesIO(start), member.file_size, alone=False)
    except InputError:
        raise
    except (*DAMAGED_ZIP, ValueError, OverflowError) as error:
        raise InputError(f"{path}: no .npz, or a damaged one ({in_short(error)}): save it again with np.savez") from None


def check_zarr(path: Path, arrays: Mapping[str, Any]) -> None:
    """Raises InputError where zarr arrays of a local folder hold objects, use unsafe codecs, or are implausibly large.

    Nothing of their chunks has been read so far.

    Raises:
        InputError: an array has another codec or dtype, or promises far more than the folder holds.
    """
    held = sum(file.lstat().st_size for file in path.rglob("*") if file.is_file())
    for name, array in arrays.items():
        for codec in codecs_of(array.metadata.to_dict()):
            if codec not in CODECS:
                raise InputError(f"{path}: '{name}' is packed by {codec!r:.60}, which is never run: pack it with blosc or zstd")
        if array.dtype.kind not in f"{PLAIN}T":
            raise InputError(f"{path}: '{name}' holds {array.dtype}, expected plain numbers or text")
        if max(array.dtype.itemsize, 1) * math.prod(array.shape) > RATIO * held + SPARE:
            raise InputError(f"{path}: '{name}' promises {array.shape} values, and the folder has {held:,} bytes: damaged")


def codecs_of(metadata: Any) -> Iterator[str]:
    """The names of all codecs in the metadata of a zarr array, of formats 2 and 3, those within others included."""
    if isinstance(metadata, Mapping):
        if "shape" not in metadata and ("id" in metadata or "name" in metadata):
            yield str(metadata.get("id", metadata.get("name"))).removeprefix("numcodecs.")
        inner = [metadata.get(key) for key in ("codecs", "index_codecs", "filters", "compressor", "configuration")]
        for value in inner:
            yield from codecs_of(value)
    elif isinstance(metadata, list | tuple):
        for value in metadata:
            yield from codecs_of(value)
    elif hasattr(metadata, "get_config"):  # of numcodecs
        yield from codecs_of(metadata.get_config())
    elif hasattr(metadata, "to_dict"):
        yield from codecs_of(metadata.to_dict())


class Header(NamedTuple):
    """The header of an array: its shape, order and type."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype
    length: int  # of the header itself, bytes


def read_header(where: str, file: IO[bytes]) -> Header:
    """The header of an array, from the start of an open .npy.

    Raises:
        InputError: there is none, or it is damaged.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            version = np.lib.format.read_magic(file)
            read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
            shape, fortran, dtype = read(file, max_header_size=LONGEST_HEADER)
    except BROKEN as error:
        raise InputError(
            f"{where}: no NumPy array, or a damaged one ({in_short(error)}): save it again with np.save or np.savez"
        ) from None
    return Header(shape, fortran, dtype, file.tell())


def check_shape(where: str, header: Header) -> None:
    """Raises InputError where the lengths of an array cannot be meant."""
    if any(not isinstance(length, int) or length < 0 for length in header.shape):
        raise InputError(f"{where}: an array of shape {header.shape}: damaged; save it again")


def _check_header(where: str, file: IO[bytes], size: int, alone: bool) -> None:
    header = read_header(where, file)
    shape, dtype = header.shape, header.dtype
    if dtype.hasobject and not alone:
        return  # one member among others, which may never be read: NumPy refuses to load it
    if dtype.hasobject or dtype.kind not in PLAIN:
        raise InputError(f"{where}: it holds {dtype}, and Python objects are never loaded: save plain numbers")
    check_shape(where, header)
    if math.prod(shape) * dtype.itemsize > size - header.length:
        raise InputError(f"{where}: an array of shape {shape} does not fit into its {size:,} bytes: truncated; save it again")
