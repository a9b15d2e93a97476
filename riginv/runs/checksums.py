"""Zip files that say whether they are still what was written: a SHA-256 of all the rest as the archive's comment.

torch.save writes zip archives and torch.load does not check their CRCs: a flipped bit would pass for a weight.
"""

import hashlib
import struct
from pathlib import Path
from typing import BinaryIO

END, END_SIZE = b"PK\x05\x06", 22  # the end of a zip archive without a comment
MARK, DIGITS = b"riginv sha256 ", 64
BLOCK = 1 << 20


def append_checksum(path: Path) -> None:
    """Seal a zip archive that has no comment yet.

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
    """Whether a file is sealed, and every byte of it is as it was then."""
    size = path.stat().st_size - DIGITS
    if size < len(MARK):
        return False
    with path.open("rb") as file:
        file.seek(size - len(MARK))
        return file.read(len(MARK)) == MARK and _digest(file, size) == file.read(DIGITS)


def _digest(file: BinaryIO, size: int) -> bytes:
    """The SHA-256 of the first bytes of an open file, which then stands behind them."""
    digest = hashlib.sha256()
    file.seek(0)
    while size > 0 and (block := file.read(min(size, BLOCK))):
        digest.update(block)
        size -= len(block)
    return digest.hexdigest().encode()
