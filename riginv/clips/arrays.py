"""Clips as NumPy arrays: .npy, and .npz with `vertices (frame, vertex, 3)` and perhaps `faces`, `fps`, `frame_numbers`.

Arrays that are stored as they are, as `np.savez` does, are read in place, window by window; compressed ones are unpacked as a
stream, from the first frame to the last, and from the start again where an earlier frame is asked for.
"""

import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from riginv.array_files import DAMAGED_ZIP, Header, check_shape, read_header
from riginv.clips.files import read_numbers
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence
from riginv.errors import InputError, in_short
from riginv.files import opened
from riginv.meshes.polygons import Polygons

VERTICES = ("vertices", "verts", "points", "positions")
LOCAL_HEADER = struct.Struct("<4s22xHH")  # of a zip's member: its signature, and how long its name and its extra field are
LARGEST_SMALL = 1 << 30  # bytes of any array but the vertices


def _layout(where: str, file: BinaryIO) -> Header:
    header = read_header(where, file)
    if header.dtype.hasobject:
        raise InputError(f"{where}: it holds Python objects, which are never loaded: save plain numbers")
    check_shape(where, header)
    return header


class ArrayClip(MeshSequence):
    """A clip in an .npy or .npz file.

    Raises:
        InputError: there is no array of vertices, or it is truncated, damaged, or of another shape or type.
    """

    def __init__(self, name: str, options: ReadingOptions) -> None:
        self.file = path = Path(name)
        self.member: zipfile.ZipInfo | None = None
        faces, fps, numbers = None, None, None
        if path.suffix.lower() == ".npz":
            with self._archive() as archive:
                self.member = _vertices_member(path, archive)
                small = {Path(name).stem: name for name in archive.namelist() if name.endswith(".npy")}
                faces = _faces(path, self._small(archive, small.get("faces")))
                fps = _fps(path, self._small(archive, small.get("fps")))
                numbers = self._small(archive, small.get("frame_numbers"))
                with archive.open(self.member) as file:
                    layout = _layout(f"{path}, {self.member.filename}", file)
        else:
            with opened(path) as file:
                layout = _layout(str(path), file)
        shape = layout.shape
        if len(shape) != 3 or shape[2] != 3 or layout.dtype.kind != "f":
            raise InputError(f"{path}: the vertices are {layout.dtype} of shape {shape}, expected floats (frame, vertex, 3)")
        self.layout, self.frame_bytes = layout, 3 * shape[1] * layout.dtype.itemsize
        self.stored = self.member is None or self.member.compress_type == zipfile.ZIP_STORED
        self.offset = layout.length + (self._start_of_member() if self.member and self.stored else 0)
        self._check_size()
        self._stream: BinaryIO | None = None
        self._stream_at = 0
        super().__init__(path, _frame_numbers(path, numbers, shape[0]), shape[1], faces, fps)

    def read(self, start: int, stop: int) -> np.ndarray:
        shape = (stop - start, self.vertex_count, 3)
        if self.layout.fortran:
            if not self.stored:
                raise InputError(f"{self.path}: compressed in Fortran order, which cannot be read frame by frame: use np.savez")
            mapped = np.memmap(self.file, self.layout.dtype, "r", self.offset, self.layout.shape, order="F")
            values = np.ascontiguousarray(mapped[start:stop])
        elif self.stored:
            values = read_numbers(self.file, self.layout.dtype, shape, self.offset + start * self.frame_bytes)
        else:
            values = np.frombuffer(self._unpacked(start, stop), self.layout.dtype).reshape(shape)
        with np.errstate(over="ignore", invalid="ignore"):
            return values.astype(np.float32)

    def _unpacked(self, start: int, stop: int) -> bytes:
        """The bytes of frames of a compressed array."""
        try:
            if self._stream is None or self._stream_at > start:
                self._stream = zipfile.ZipFile(self.file).open(self.member)
                self._skip(self._stream, self.layout.length)
                self._stream_at = 0
            self._skip(self._stream, (start - self._stream_at) * self.frame_bytes)
            wanted = (stop - start) * self.frame_bytes
            data = self._stream.read(wanted)
        except (*DAMAGED_ZIP, OSError) as error:
            raise InputError(
                f"{self.path}: {self.member.filename} cannot be unpacked ({error}): damaged; copy it again"
            ) from None
        if len(data) < wanted:
            raise InputError(f"{self.path}: {self.member.filename} ends early: truncated; copy it or save it again")
        self._stream_at = stop
        return data

    @staticmethod
    def _skip(stream: BinaryIO, count: int) -> None:
        while count > 0 and (passed := len(stream.read(min(count, 1 << 22)))):
            count -= passed

    @contextmanager
    def _archive(self) -> Iterator[zipfile.ZipFile]:
        try:
            with opened(self.file) as file, zipfile.ZipFile(file) as archive:
                yield archive
        except (*DAMAGED_ZIP, UnicodeDecodeError) as error:
            raise InputError(f"{self.file}: no .npz, or a damaged one ({in_short(error)}): copy it or save it again") from None

    def _small(self, archive: zipfile.ZipFile, name: str | None) -> np.ndarray | None:
        """One of the small arrays beside the vertices."""
        if name is None:
            return None
        with archive.open(name) as file:
            layout = _layout(f"{self.file}, {name}", file)
            size = int(np.prod([float(length) for length in layout.shape]) * layout.dtype.itemsize)
            if size > LARGEST_SMALL:
                raise InputError(f"{self.file}: {name} would be {size / 1e9:.1f} GB: damaged; save it again")
            data = file.read(size)
        if len(data) < size or layout.dtype.itemsize == 0:
            raise InputError(f"{self.file}: {name} is truncated; save it again")
        return np.frombuffer(data, layout.dtype).reshape(layout.shape, order="F" if layout.fortran else "C")

    def _start_of_member(self) -> int:
        """The byte at which a stored member's own content starts; the directory at the end of a zip does not say it."""
        with opened(self.file) as file:
            file.seek(self.member.header_offset)
            signature, name, extra = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size).ljust(LOCAL_HEADER.size, b"\0"))
        if signature != b"PK\3\4":
            raise InputError(f"{self.file}: {self.member.filename} is not where the archive says: damaged; copy it again")
        return self.member.header_offset + LOCAL_HEADER.size + name + extra

    def _check_size(self) -> None:
        """That the file is as long as its header promises; a header may lie."""
        needed = self.frame_bytes * self.layout.shape[0] + (self.offset if self.stored else self.layout.length)
        found = self.file.stat().st_size if self.stored else self.member.file_size
        if found < needed:
            raise InputError(
                f"{self.file}: the header promises {self.layout.shape[0]} frames of {self.layout.shape[1]} vertices, {needed} "
                f"bytes, and there are {found}: truncated; copy it or save it again"
            )


def _vertices_member(path: Path, archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    found = {Path(info.filename).stem: info for info in archive.infolist() if info.filename.endswith(".npy")}
    name = next((name for name in VERTICES if name in found), None)
    if name is None:
        raise InputError(
            f"{path}: no array of vertices: expected one named {' or '.join(VERTICES)}, found "
            f"{', '.join(list(found)[:8]) or 'none'}"
        )
    if found[name].flag_bits & 1:
        raise InputError(f"{path}: it is encrypted; save it without a password")
    return found[name]


def _faces(path: Path, faces: np.ndarray | None) -> Polygons | None:
    if faces is None or not faces.size:
        return None
    if faces.ndim != 2 or faces.shape[1] < 3 or faces.dtype.kind not in "iu":
        raise InputError(f"{path}: faces are {faces.dtype} of shape {faces.shape}, expected whole numbers (face, 3)")
    with np.errstate(over="ignore"):
        corners = faces.astype(np.int64)
    return Polygons(np.full(len(faces), faces.shape[1], np.int64), corners.reshape(-1))


def _fps(path: Path, fps: np.ndarray | None) -> float | None:
    if fps is None:
        return None
    if fps.size != 1 or fps.dtype.kind not in "iuf":
        raise InputError(f"{path}: fps is {fps.dtype} of shape {fps.shape}, expected one number")
    return float(fps.reshape(-1)[0])


def _frame_numbers(path: Path, numbers: np.ndarray | None, frames: int) -> np.ndarray:
    if numbers is None:
        return np.arange(frames)
    if numbers.shape != (frames,) or numbers.dtype.kind not in "iu":
        raise InputError(f"{path}: frame_numbers are {numbers.dtype} of shape {numbers.shape}, expected {frames} whole numbers")
    return numbers.astype(np.int64)
