"""Checksums: of files, folders, texts, tensors and arrays, and zip archives and texts that carry their own.

torch.save writes zip archives and torch.load does not check their CRCs: a flipped bit would pass for a weight. So checkpoints
end in a SHA-256 of all the rest, as the comment of the archive.
"""

import hashlib
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import google_crc32c
import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

END, END_SIZE = b"PK\x05\x06", 22  # the end of a zip archive without a comment
MARK, DIGITS = b"riginv sha256 ", 64
BLOCK = 1 << 20
TEXT_MARK = "# SHA-256 of the lines above: "
SUMS = "SHA256SUMS"


def sha256(path: Path) -> str:
    """The SHA-256 of a file's content, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def text_sha256(text: str) -> str:
    """The SHA-256 of a text, in hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def tensors_sha256(tensors: "Mapping[str, Tensor]") -> str:
    """The SHA-256 of named tensors with their types and shapes, in hexadecimal."""
    import torch  # takes seconds, and --help needs none

    digest = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        digest.update(tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def crc32c(values: np.ndarray) -> int:
    """The CRC-32C of an array's numbers."""
    return google_crc32c.value(np.ascontiguousarray(values).view(np.uint8).reshape(-1))


def write_sums(folder: Path) -> None:
    """Write `SHA256SUMS` of all files in a folder, as `sha256sum -c` reads it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    lines = [f"{sha256(path)}  {path.relative_to(folder).as_posix()}\n" for path in files]
    (folder / SUMS).write_text("".join(lines), encoding="utf-8")


def with_checksum(text: str) -> str:
    """A text of lines, and its SHA-256 as a comment in the last one."""
    return f"{text}{TEXT_MARK}{text_sha256(text)}\n"


def is_as_written(text: str) -> bool:
    """Whether a text ends in the checksum that `with_checksum` gave it."""
    lines, _, digest = text.rpartition(TEXT_MARK)
    return digest.strip() == text_sha256(lines)


def append_checksum(path: Path) -> None:
    """Append its SHA-256 to a zip archive that has no comment yet.

    Raises:
        ValueError: it is no such archive.
    """
    with path.open("r+b") as file:
        start = file.seek(0, 2) - END_SIZE
        file.seek(max(start, 0))
        end = file.read(END_SIZE)
        if not (end.startswith(END) and end.endswith(b"\0\0")):
            raise ValueError(f"{path}: not a zip archive without a comment")
        file.seek(start + END_SIZE - 2)
        file.write(struct.pack("<H", len(MARK) + DIGITS) + MARK)
        size = file.tell()
        digest = _digest(file, size)
        file.seek(size)
        file.write(digest)


def has_valid_checksum(path: Path) -> bool:
    """Whether a zip archive ends in its SHA-256, and every byte of it is as it was then."""
    size = path.stat().st_size - DIGITS
    if size < len(MARK):
        return False
    with path.open("rb") as file:
        file.seek(size - len(MARK))
        return file.read(len(MARK)) == MARK and _digest(file, size) == file.read(DIGITS)


def _digest(file: BinaryIO, size: int) -> bytes:
    """The SHA-256 of the first `size` bytes of an open file; moves its position behind them."""
    digest = hashlib.sha256()
    file.seek(0)
    while size > 0 and (block := file.read(min(size, BLOCK))):
        digest.update(block)
        size -= len(block)
    return digest.hexdigest().encode()
