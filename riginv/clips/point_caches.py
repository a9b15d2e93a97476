"""Point caches: MDD (big-endian, with the time of each frame in seconds) and PC2 (little-endian, with a sampling step).

Source: the layouts of Blender's Mesh Cache modifier and export add-ons. Some programs write them in the other byte order, or
frames in place of seconds.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.array_facts import read_numbers
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MAX_VERTICES, MeshSequence, SourceFacts
from riginv.clips.times import FrameTimes, frames_at_step, frames_from_times
from riginv.errors import InputError
from riginv.runs.files import opened

MOST_FRAMES = 10_000_000
PC2_SIGNATURE = b"POINTCACHE2\0"
PC2_HEADER = np.dtype(
    [("signature", "S12"), ("version", "<i4"), ("vertices", "<i4"), ("start", "<f4"), ("rate", "<f4"), ("frames", "<i4")]
)
PC2_VERSION = 1
SWAPPED = {">": "<", "<": ">"}
ORDERS = {">": "big-endian", "<": "little-endian"}


class Layout(NamedTuple):
    """The header of a point cache.

    Attributes:
        kind: MDD or PC2.
        frames, vertices: number of them.
        offset: the byte at which the vertices start.
        order: byte order, `<` or `>`.
        is_usual: whether that is the byte order of the format.
    """

    kind: str
    frames: int
    vertices: int
    offset: int
    order: str
    is_usual: bool = True

    @property
    def needed(self) -> int:
        """Size that the file must have, bytes."""
        return self.offset + 12 * self.frames * self.vertices

    @property
    def possible(self) -> bool:
        return 1 <= self.frames <= MOST_FRAMES and 1 <= self.vertices <= MAX_VERTICES


class PointCache(MeshSequence):
    """A header, then the vertices of all frames as 32-bit floats.

    Raises:
        InputError: the file is shorter than its header promises, or the header is implausible.
    """

    def __init__(self, path: Path, layout: Layout, times: FrameTimes, notes: tuple[str, ...]) -> None:
        self.file, self.layout = path, layout
        found = _size(path)
        if found < layout.needed:
            raise InputError(
                f"{path}: its header promises {layout.frames} frames of {layout.vertices} vertices, {layout.needed} bytes, and "
                f"it has {found}: truncated; copy it or export it again"
            )
        if not layout.is_usual:
            notes = (
                f"{layout.kind} is {ORDERS[SWAPPED[layout.order]]}; this file is {ORDERS[layout.order]}, and read so.",
                *notes,
            )
        if found > layout.needed:
            more = (found - layout.needed) // (12 * layout.vertices)
            notes = (
                *notes,
                f"The file has {found - layout.needed:,} bytes after the {layout.frames:,} frames of its header"
                + (f", enough for {more:,} frames more, which were not read." if more else ", which were not read."),
            )
        facts = SourceFacts(layout.kind, rate_source=times.rate_source, notes=(*notes, *times.notes))
        super().__init__(path, times.numbers, layout.vertices, fps=times.fps, facts=facts)

    def read(self, start: int, stop: int) -> np.ndarray:
        offset = self.layout.offset + 12 * start * self.vertex_count
        dtype = np.dtype(f"{self.layout.order}f4")
        values = read_numbers(self.file, dtype, (stop - start, self.vertex_count, 3), offset)
        with np.errstate(invalid="ignore"):
            return values.astype(np.float32)


class MddCache(PointCache):
    """An .mdd file: number of frames and of vertices, time of each frame, vertices.

    Raises:
        InputError: it is truncated or no MDD.
    """

    def __init__(self, name: str, options: ReadingOptions) -> None:
        path = Path(name)
        counts = read_numbers(path, np.dtype("u1"), (8,), 0)
        layout = _plausible(path, _mdd(counts, ">"), _mdd(counts, "<"))
        if _size(path) < layout.offset:
            raise InputError(
                f"{path}: {_size(path)} bytes, too few for the times of {layout.frames} frames: truncated, or no MDD"
            )
        with np.errstate(invalid="ignore"):
            times = read_numbers(path, np.dtype(f"{layout.order}f4"), (layout.frames,), 8).astype(np.float32)
        super().__init__(path, layout, frames_from_times(times, "times"), options.unused("MDD"))


class Pc2Cache(PointCache):
    """A .pc2 file.

    Raises:
        InputError: it is truncated or no PC2.
    """

    def __init__(self, name: str, options: ReadingOptions) -> None:
        path = Path(name)
        data = read_numbers(path, np.dtype("u1"), (PC2_HEADER.itemsize,), 0)
        header = np.frombuffer(data, PC2_HEADER)[0]
        if header["signature"] != PC2_SIGNATURE.rstrip(b"\0"):
            raise InputError(f"{path}: it starts with {bytes(header['signature'])[:12]!r}, expected {PC2_SIGNATURE!r}: no PC2")
        swapped = np.frombuffer(data, PC2_HEADER.newbyteorder())[0]
        layout = _plausible(path, _pc2(header, "<"), _pc2(swapped, ">"))
        header = header if layout.is_usual else swapped
        notes = options.unused("PC2")
        if header["version"] != PC2_VERSION:
            notes += (f"It is a PC2 of version {header['version']}, and was read as one of version {PC2_VERSION}.",)
        times = frames_at_step(float(header["start"]), float(header["rate"]), layout.frames)
        super().__init__(path, layout, times, notes)


def _mdd(counts: np.ndarray, order: str) -> Layout:
    frames, vertices = (int(number) for number in np.frombuffer(counts, f"{order}i4"))
    return Layout("MDD", frames, vertices, 8 + 4 * frames, order, order == ">")


def _pc2(header: np.void, order: str) -> Layout:
    return Layout("PC2", int(header["frames"]), int(header["vertices"]), PC2_HEADER.itemsize, order, order == "<")


def _plausible(path: Path, usual: Layout, swapped: Layout) -> Layout:
    """The layout in the format's byte order, or in the other one if only that fits the file size exactly.

    Raises:
        InputError: neither is plausible.
    """
    size = _size(path)
    if swapped.possible and swapped.needed == size and not (usual.possible and usual.needed <= size):
        return swapped
    if not usual.possible:
        raise InputError(
            f"{path}: {usual.frames} frames of {usual.vertices} vertices: damaged, without any frame, or no {usual.kind}"
        )
    return usual


def _size(path: Path) -> int:
    with opened(path) as file:
        return file.seek(0, 2)
