"""Point caches: MDD, big-endian, with the time of each frame; PC2, little-endian.

Source: their layouts as Blender's manual describes them for the Mesh Cache modifier, and its add-ons write them.
"""

from pathlib import Path

import numpy as np

from riginv.clips.files import opened, read_numbers
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MOST_VERTICES, MeshSequence
from riginv.errors import InputError

MOST_FRAMES = 10_000_000
PC2_SIGNATURE = b"POINTCACHE2\0"
PC2_HEADER = np.dtype(
    [("signature", "S12"), ("version", "<i4"), ("vertices", "<i4"), ("start", "<f4"), ("rate", "<f4"), ("frames", "<i4")]
)


class PointCache(MeshSequence):
    """What both have in common: after a header, the vertices of all frames as single floats.

    Args:
        dtype: of these, with its byte order.
        offset: the byte at which they start.
    """

    def __init__(
        self, path: Path, frames: int, vertices: int, dtype: str, offset: int, start: int = 0, fps: float | None = None
    ) -> None:
        self.file, self.dtype, self.offset = path, np.dtype(dtype), offset
        needed, found = offset + 12 * frames * vertices, _size(path)
        if found < needed:
            raise InputError(
                f"{path}: its header promises {frames} frames of {vertices} vertices, {needed} bytes, and it has {found}: "
                f"truncated; copy it or export it again"
            )
        super().__init__(path, np.arange(start, start + frames), vertices, fps=fps)

    def read(self, start: int, stop: int) -> np.ndarray:
        offset = self.offset + 12 * start * self.vertex_count
        values = read_numbers(self.file, self.dtype, (stop - start, self.vertex_count, 3), offset)
        with np.errstate(invalid="ignore"):
            return values.astype(np.float32)


class MddCache(PointCache):
    """An .mdd: the number of frames and of vertices, the time of each frame, the vertices.

    Raises:
        InputError: it is truncated or no MDD.
    """

    def __init__(self, name: str, options: ReadingOptions) -> None:
        path = Path(name)
        frames, vertices = (int(number) for number in read_numbers(path, np.dtype(">i4"), (2,), 0))
        _check_counts(path, frames, vertices, "MDD")
        if _size(path) < 8 + 4 * frames:
            raise InputError(f"{path}: {_size(path)} bytes, too few for the times of {frames} frames: truncated, or no MDD")
        with np.errstate(invalid="ignore"):
            times = read_numbers(path, np.dtype(">f4"), (frames,), 8).astype(np.float64)
        super().__init__(path, frames, vertices, ">f4", 8 + 4 * frames, fps=_rate(times))


class Pc2Cache(PointCache):
    """A .pc2: a header, the vertices.

    Raises:
        InputError: it is truncated or no PC2.
    """

    def __init__(self, name: str, options: ReadingOptions) -> None:
        path = Path(name)
        header = np.frombuffer(read_numbers(path, np.dtype("u1"), (PC2_HEADER.itemsize,), 0), PC2_HEADER)[0]
        if header["signature"] != PC2_SIGNATURE.rstrip(b"\0"):
            raise InputError(f"{path}: it starts with {bytes(header['signature'])[:12]!r}, expected {PC2_SIGNATURE!r}: no PC2")
        frames, vertices, start = int(header["frames"]), int(header["vertices"]), float(header["start"])
        _check_counts(path, frames, vertices, "PC2")
        first = round(start) if abs(start) < MOST_FRAMES else 0
        super().__init__(path, frames, vertices, "<f4", PC2_HEADER.itemsize, first)


def _check_counts(path: Path, frames: int, vertices: int, kind: str) -> None:
    if not 1 <= frames <= MOST_FRAMES or not 1 <= vertices <= MOST_VERTICES:
        raise InputError(f"{path}: {frames} frames of {vertices} vertices: damaged, without any frame, or no {kind}")


def _size(path: Path) -> int:
    with opened(path) as file:
        return file.seek(0, 2)


def _rate(times: np.ndarray) -> float | None:
    """Frames a second, where frames follow each other evenly; None where they do not say."""
    steps = np.diff(times)
    if not len(steps) or not np.isfinite(steps).all():
        return None
    step = (times[-1] - times[0]) / len(steps)
    if not step > 0 or np.abs(steps - step).max() > 0.05 * step:
        return None
    return round(1 / step, 3)
