"""Bytes of a glTF file: chunks of a .glb, files beside a .gltf, and data URIs; nothing else is opened."""

import base64
import binascii
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from riginv.errors import InputError

MAGIC, VERSION, HEADER, CHUNK_HEADER = b"glTF", 2, 12, 8
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
DATA_URI, BASE64 = "data:", ";base64,"


def chunks(path: Path, data: np.ndarray) -> tuple[bytes, np.ndarray | None]:
    """The JSON and the binary chunk of a .glb.

    Args:
        data: bytes of the file, `(byte,)`.

    Raises:
        InputError: it is truncated or damaged.
    """
    if len(data) < HEADER + CHUNK_HEADER:
        raise InputError(f"{path}: {len(data)} bytes, too short for a .glb: the file is truncated; copy or export it again")
    version, length = (int(number) for number in np.frombuffer(data[4:HEADER].tobytes(), "<u4"))
    if version != VERSION:
        raise InputError(f"{path}: a .glb of version {version}, expected {VERSION}: export it again as glTF 2.0")
    if length > len(data):
        raise InputError(
            f"{path}: {len(data)} bytes, expected {length} by its header: the file is truncated; copy or export it again"
        )
    chunks_by_kind: dict[int, np.ndarray] = {}
    start = HEADER
    while start + CHUNK_HEADER <= length:
        size, kind = (int(number) for number in np.frombuffer(data[start : start + CHUNK_HEADER].tobytes(), "<u4"))
        start += CHUNK_HEADER
        if start + size > length:
            raise InputError(
                f"{path}: a part of {size} bytes starts at byte {start} of {length}: the file is damaged; export it again"
            )
        chunks_by_kind.setdefault(kind, data[start : start + size])
        start += size
    if JSON_CHUNK not in chunks_by_kind:
        raise InputError(f"{path}: a .glb without its JSON part: the file is damaged; export it again")
    return chunks_by_kind[JSON_CHUNK].tobytes(), chunks_by_kind.get(BINARY_CHUNK)


def bytes_of(path: Path, user: str) -> np.ndarray:
    """Bytes of a file `(byte,)`, memory-mapped.

    Raises:
        InputError: it is missing or cannot be read.
    """
    try:
        found = path.is_file()
    except (OSError, ValueError):
        found = False
    if not found:
        raise InputError(f"{path}: no such file, needed by {user}")
    try:
        return np.memmap(path, dtype=np.uint8, mode="r") if path.stat().st_size else np.zeros(0, np.uint8)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from None


def beside(path: Path, where: str, uri: str) -> Path:
    """The file that a URI names, inside the folder of the glTF file.

    Args:
        path: of the glTF file.
        where: what names it, for the message.

    Raises:
        InputError: it is outside that folder, links resolved.
    """
    name = unquote(uri)
    folder = path.parent.resolve()
    try:
        target = (folder / name).resolve()
    except (OSError, ValueError, RuntimeError):
        target = folder.parent
    if "://" in name or not target.is_relative_to(folder) or "\0" in name:
        raise InputError(
            f"{path}: {where} names {uri[:80]!r}, expected a file in the avatar's own folder: put it there, or export a .glb"
        )
    return target


def from_data_uri(path: Path, where: str, uri: str) -> np.ndarray:
    """Bytes `(byte,)` of a data URI.

    Raises:
        InputError: it is not valid base64.
    """
    _, mark, body = uri.partition(BASE64)
    try:
        if not mark:
            raise ValueError("it is not marked as base64")
        return np.frombuffer(base64.b64decode(unquote(body), validate=True), np.uint8)
    except (ValueError, binascii.Error) as error:
        raise InputError(f"{path}: {where} holds data that cannot be decoded: {error}; export it again") from None
