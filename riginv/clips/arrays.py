"""Clips as NumPy arrays: .npy, and .npz with `vertices (frame, vertex, 3)` and perhaps faces, a rate, times, frame numbers.

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

from riginv.clips.array_facts import BESIDE, faces_of, frame_times, read_numbers
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, SourceFacts
from riginv.errors import InputError, in_short
from riginv.runs.array_files import DAMAGED_ZIP, Header, check_shape, read_header
from riginv.runs.files import opened

VERTICES = ("vertices", "verts", "points", "positions")
LOCAL_HEADER = struct.Struct("<4s22xHH")  # of a zip's member: its signature, and how long its name and its extra field are
LARGEST_SMALL = 1 << 30  # bytes of any array but the vertices


def _layout(where: str, header: Header) -> Header:
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
        beside: dict[str, np.ndarray] = {}
        others: tuple[str, ...] = ()
        notes = list(options.unused(f"NumPy {path.suffix.lower()}", path.suffix.lower() != ".npz"))
        if path.suffix.lower() == ".npz":
            with self._archive() as archive:
                layouts = _layouts(path, archive)
                self.member = _vertices_member(path, archive, layouts, options.mesh_names, notes)
                layout = _layout(f"{path}, {self.member.filename}", layouts[self.member.filename])
                names = {Path(member).stem: member for member in layouts if member != self.member.filename}
                beside = {name: self._small(archive, names[name]) for name in BESIDE if name in names}
                others = tuple(stem for stem, member in names.items() if _is_mesh(layouts[member]) and stem not in BESIDE)
        else:
            with opened(path) as file:
                layout = _layout(str(path), read_header(str(path), file))
        _check_vertices(path, layout)
        self.layout, self.frame_bytes = layout, 3 * layout.shape[1] * layout.dtype.itemsize
        self.stored = self.member is None or self.member.compress_type == zipfile.ZIP_STORED
        self.offset = layout.length + (self._start_of_member() if self.member and self.stored else 0)
        self._check_size()
        self._stream: BinaryIO | None = None
        self._stream_at = 0
        times = frame_times(path, beside, layout.shape[0], notes)
        read = (Path(self.member.filename).stem,) if self.member else ()
        facts = SourceFacts(f"NumPy {path.suffix.lower()}", read, others, rate_source=times.rate_source, notes=tuple(notes))
        super().__init__(path, times.numbers, layout.shape[1], faces_of(path, beside), times.fps, facts=facts)

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

    def _small(self, archive: zipfile.ZipFile, name: str) -> np.ndarray:
        """One of the small arrays beside the vertices."""
        with archive.open(name) as file:
            layout = _layout(f"{self.file}, {name}", read_header(f"{self.file}, {name}", file))
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


def _layouts(path: Path, archive: zipfile.ZipFile) -> dict[str, Header]:
    """The headers of all arrays in an archive, by the names of its members."""
    layouts = {}
    for info in archive.infolist():
        if info.filename.endswith(".npy"):
            if info.flag_bits & 1:
                raise InputError(f"{path}: it is encrypted; save it without a password")
            with archive.open(info) as file:
                layouts[info.filename] = read_header(f"{path}, {info.filename}", file)
    return layouts


def _is_mesh(layout: Header) -> bool:
    """Whether an array may hold the vertices of each frame."""
    return len(layout.shape) == 3 and layout.shape[2] == 3 and layout.dtype.kind == "f"


def _vertices_member(
    path: Path, archive: zipfile.ZipFile, layouts: dict[str, Header], asked: list[str], notes: list[str]
) -> zipfile.ZipInfo:
    """The array of vertices: the one that was asked for, one of a known name, or else the only one that can be."""
    found = {Path(member).stem: member for member in layouts}
    if asked:
        if len(asked) > 1 or asked[0] not in found:
            raise InputError(
                f"{path}: reading.mesh names {', '.join(asked)}, expected one of its arrays: {', '.join(list(found)[:12])}"
            )
        return archive.getinfo(found[asked[0]])
    named = [name for name in VERTICES if name in found]
    able = [name for name in (*named, *(other for other in found if other not in named)) if _is_mesh(layouts[found[name]])]
    if able and (able[0] in named or len(able) == 1):
        if able[0] not in named:
            notes.append(f"The array {able[0]!r} was taken for the vertices: no other has the shape (frame, vertex, 3).")
        return archive.getinfo(found[able[0]])
    if named:
        return archive.getinfo(found[named[0]])
    listed = ", ".join((able or list(found))[:8]) or "none"
    raise InputError(
        f"{path}: no array of vertices: expected one named {' or '.join(VERTICES)}, found {listed}"
        + (f", and any of these {len(able)} could be it: reading.mesh=NAME says which" if able else "")
    )


def _check_vertices(path: Path, layout: Header) -> None:
    if len(layout.shape) == 3 and layout.shape[2] == 3 and layout.dtype.kind in "iu":
        raise InputError(
            f"{path}: the vertices are whole numbers ({layout.dtype}), expected floats: save them as float32 in the units that "
            f"they are meant in; where they are quantised, scale them first"
        )
    if not _is_mesh(layout):
        raise InputError(f"{path}: the vertices are {layout.dtype} of shape {layout.shape}, expected floats (frame, vertex, 3)")
