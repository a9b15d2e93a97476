"""Clips as NumPy arrays: .npy, and .npz with `vertices (frame, vertex, 3)` and optional faces, rate, times, frame numbers.

Uncompressed arrays (`np.savez`) are read in place, window by window. Compressed arrays are decompressed as a stream, which
restarts when an earlier frame is requested.
"""

import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from riginv.clips.array_facts import METADATA, faces_of, frame_times, read_numbers
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, SourceFacts
from riginv.errors import InputError, in_short, listed
from riginv.runs.array_files import DAMAGED_ZIP, Header, check_shape, read_header
from riginv.runs.files import opened

VERTICES = ("vertices", "verts", "points", "positions")
LOCAL_HEADER = struct.Struct("<4s22xHH")  # of a zip member: signature, lengths of its name and of its extra field
MAX_METADATA_BYTES = 1 << 30  # of any array but the vertices


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
        metadata: dict[str, np.ndarray] = {}
        others: tuple[str, ...] = ()
        notes = list(options.unused(f"NumPy {path.suffix.lower()}", path.suffix.lower() != ".npz"))
        if path.suffix.lower() == ".npz":
            with self._archive() as archive:
                layouts = _layouts(path, archive)
                self.member = _vertices_member(path, archive, layouts, options.mesh_names, notes)
                layout = _layout(f"{path}, {self.member.filename}", layouts[self.member.filename])
                names = {Path(member).stem: member for member in layouts if member != self.member.filename}
                metadata = {name: self._metadata(archive, names[name]) for name in METADATA if name in names}
                others = tuple(stem for stem, member in names.items() if _is_mesh(layouts[member]) and stem not in METADATA)
        else:
            with opened(path) as file:
                layout = _layout(str(path), read_header(str(path), file))
        _check_vertices(path, layout)
        self.layout, self.frame_bytes = layout, 3 * layout.shape[1] * layout.dtype.itemsize
        self.stored = self.member is None or self.member.compress_type == zipfile.ZIP_STORED
        self.offset = layout.length + (self._data_start(self.member) if self.member and self.stored else 0)
        self._check_size()
        self._stream: IO[bytes] | None = None
        self._stream_frame = 0
        times = frame_times(path, metadata, layout.shape[0], notes)
        read = (Path(self.member.filename).stem,) if self.member else ()
        facts = SourceFacts(f"NumPy {path.suffix.lower()}", read, others, rate_source=times.rate_source, notes=tuple(notes))
        super().__init__(path, times.numbers, layout.shape[1], faces_of(path, metadata), times.fps, facts=facts)

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
            assert self.member is not None
            values = np.frombuffer(self._decompressed(self.member, start, stop), self.layout.dtype).reshape(shape)
        with np.errstate(over="ignore", invalid="ignore"):
            return values.astype(np.float32)

    def _decompressed(self, member: zipfile.ZipInfo, start: int, stop: int) -> bytes:
        """The bytes of frames of a compressed array."""
        try:
            stream = self._stream
            if stream is None or self._stream_frame > start:
                stream = self._stream = zipfile.ZipFile(self.file).open(member)
                self._skip(stream, self.layout.length)
                self._stream_frame = 0
            self._skip(stream, (start - self._stream_frame) * self.frame_bytes)
            wanted = (stop - start) * self.frame_bytes
            data = stream.read(wanted)
        except (*DAMAGED_ZIP, OSError) as error:
            raise InputError(f"{self.path}: {member.filename} cannot be unpacked ({error}): damaged; copy it again") from None
        if len(data) < wanted:
            raise InputError(f"{self.path}: {member.filename} ends early: truncated; copy it or save it again")
        self._stream_frame = stop
        return data

    @staticmethod
    def _skip(stream: IO[bytes], count: int) -> None:
        while count > 0 and (passed := len(stream.read(min(count, 1 << 22)))):
            count -= passed

    @contextmanager
    def _archive(self) -> Iterator[zipfile.ZipFile]:
        try:
            with opened(self.file) as file, zipfile.ZipFile(file) as archive:
                yield archive
        except (*DAMAGED_ZIP, UnicodeDecodeError) as error:
            raise InputError(f"{self.file}: no .npz, or a damaged one ({in_short(error)}): copy it or save it again") from None

    def _metadata(self, archive: zipfile.ZipFile, name: str) -> np.ndarray:
        """One of the arrays beside the vertices."""
        with archive.open(name) as file:
            layout = _layout(f"{self.file}, {name}", read_header(f"{self.file}, {name}", file))
            size = int(np.prod([float(length) for length in layout.shape]) * layout.dtype.itemsize)
            if size > MAX_METADATA_BYTES:
                raise InputError(f"{self.file}: {name} would be {size / 1e9:.1f} GB: damaged; save it again")
            data = file.read(size)
        if len(data) < size or layout.dtype.itemsize == 0:
            raise InputError(f"{self.file}: {name} is truncated; save it again")
        return np.frombuffer(data, layout.dtype).reshape(layout.shape, order="F" if layout.fortran else "C")

    def _data_start(self, member: zipfile.ZipInfo) -> int:
        """The byte at which the data of an uncompressed member start; a zip's central directory does not hold it."""
        with opened(self.file) as file:
            file.seek(member.header_offset)
            signature, name, extra = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size).ljust(LOCAL_HEADER.size, b"\0"))
        if signature != b"PK\3\4":
            raise InputError(f"{self.file}: {member.filename} is not at its position in the archive: damaged; copy it again")
        return member.header_offset + LOCAL_HEADER.size + name + extra

    def _check_size(self) -> None:
        """Check that the file is as long as its header promises."""
        needed = self.frame_bytes * self.layout.shape[0] + (self.offset if self.stored else self.layout.length)
        found = self.file.stat().st_size if self.stored or self.member is None else self.member.file_size
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
    """Whether an array can hold the vertices of all frames."""
    return len(layout.shape) == 3 and layout.shape[2] == 3 and layout.dtype.kind == "f"


def _vertices_member(
    path: Path, archive: zipfile.ZipFile, layouts: dict[str, Header], requested: list[str], notes: list[str]
) -> zipfile.ZipInfo:
    """The array of vertices: the requested one, one with a known name, or else the only one of a fitting shape."""
    found = {Path(member).stem: member for member in layouts}
    if requested:
        if len(requested) > 1 or requested[0] not in found:
            raise InputError(f"{path}: reading.mesh names {', '.join(requested)}, expected one of its arrays: {listed(found)}")
        return archive.getinfo(found[requested[0]])
    named = [name for name in VERTICES if name in found]
    candidates = [
        name for name in (*named, *(other for other in found if other not in named)) if _is_mesh(layouts[found[name]])
    ]
    if candidates and (candidates[0] in named or len(candidates) == 1):
        if candidates[0] not in named:
            notes.append(f"The array {candidates[0]!r} was taken for the vertices: no other has the shape (frame, vertex, 3).")
        return archive.getinfo(found[candidates[0]])
    if named:
        return archive.getinfo(found[named[0]])
    raise InputError(
        f"{path}: no array of vertices: expected one named {' or '.join(VERTICES)}, found {listed(candidates or found)}"
        + (f", and any of these {len(candidates)} could be it: choose one with reading.mesh=NAME" if candidates else "")
    )


def _check_vertices(path: Path, layout: Header) -> None:
    if len(layout.shape) == 3 and layout.shape[2] == 3 and layout.dtype.kind in "iu":
        raise InputError(
            f"{path}: the vertices are whole numbers ({layout.dtype}), expected floats: save them as float32 in the units that "
            f"they are meant in; where they are quantised, scale them first"
        )
    if not _is_mesh(layout):
        one = "; one mesh is a frame, too: save vertices[None]" if len(layout.shape) == 2 and layout.shape[1] == 3 else ""
        raise InputError(
            f"{path}: the vertices are {layout.dtype} of shape {layout.shape}, expected floats (frame, vertex, 3){one}"
        )
