"""Sample times of Alembic archives, read from the file, since Blender does not expose them (standard library and NumPy).

An Ogawa archive (github.com/alembic/alembic, lib/Alembic/Ogawa and AbcCoreOgawa/ReadUtil.cpp) starts with 8 bytes, the last two
of them its version, and the position of its root group: a count and as many positions, bit 63 of which marks data, a size and
as many bytes. The fourth child is the archive's metadata, the fifth its time samplings.
"""

import re
import struct
from typing import BinaryIO, NamedTuple

import numpy as np

ACYCLIC = np.finfo(np.float64).max / 32  # seconds to a cycle where all times are listed
IS_DATA = 1 << 63
METADATA, SAMPLINGS = 3, 4  # children of the root group
MOST_CHILDREN = 1000
MOST_SAMPLES = 10_000_000
HELD_SAMPLES = 100_000  # that need no bytes of their own, since they repeat the last
NEAR = 1e-3  # of a frame
SLOWEST, FASTEST = 5.0, 1000.0  # samples a second that are frames
COMMON_RATES = (15.0, 24_000 / 1001, 24.0, 25.0, 30_000 / 1001, 30.0, 48.0, 50.0, 60_000 / 1001, 60.0, 90.0, 100.0, 120.0)


class Sampling(NamedTuple):
    """Times of samples.

    Attributes:
        count: of samples.
        period: seconds to a cycle; ACYCLIC: `times` are all there are.
        times: of the first cycle, `(sample,)`, seconds.
    """

    count: int
    period: float
    times: np.ndarray


class Frames(NamedTuple):
    """Frames of a file.

    Attributes:
        numbers: `(frame,)`, ascending.
        seconds: of each, `(frame,)`.
        fps: frames per second; 0: not known.
        source: of the frame rate.
        notes: sentences about guesses and what was ignored.
    """

    numbers: np.ndarray
    seconds: np.ndarray
    fps: float
    source: str
    notes: tuple[str, ...] = ()


def archive_frames(file: str) -> Frames | None:
    """Frames of an archive; None where it has no sample times (older format) or nothing moves."""
    try:
        with open(file, "rb") as opened:
            samplings, fps = _read(opened)
    except (OSError, ValueError, struct.error):
        return None
    moving = [sampling for sampling in samplings if sampling.count > 1]
    if not moving:
        return None
    longest = max(moving, key=lambda sampling: (sampling.count / len(sampling.times), sampling.count))
    frames = _acyclic(longest, fps) if longest.period >= ACYCLIC else _cyclic(longest, fps)
    rates = {round(1 / sampling.period, 3) for sampling in moving if sampling.period < ACYCLIC}
    if frames and len(rates) > 1:
        listed = ", ".join(f"{rate:g}" for rate in sorted(rates))
        note = f"The archive has samplings of {listed} frames a second: the one with most frames was taken (reading.fps=...)."
        frames = frames._replace(notes=(*frames.notes, note))
    return frames


def _cyclic(sampling: Sampling, fps: float | None) -> Frames | None:
    """One frame for each cycle: at its sample, or, with several around each frame, at the frame itself."""
    period, per_cycle = sampling.period, len(sampling.times)
    if not 1 / FASTEST <= period:
        return None
    count, start = -(-sampling.count // per_cycle), sampling.times[0] / period
    source, notes = "the archive's time sampling", []
    if per_cycle > 1:
        low, high = sampling.times.min() / period, sampling.times.max() / period
        start = np.clip(np.round((low + high) / 2), np.ceil(low - NEAR), max(np.floor(high + NEAR), np.ceil(low - NEAR)))
        notes.append(f"{per_cycle} samples stand around each frame, as for motion blur: each frame was read at its own time.")
    number = np.round(start) if abs(start - np.round(start)) < NEAR else np.floor(start)
    if not abs(number) < 2**53:
        return None
    rate = 1 / period
    if rate < SLOWEST:
        rate, source = (fps, "FramesPerTimeUnit of the archive") if fps else (0.0, "")
        notes.append(
            f"Its samples are {period:g} s apart, which can hardly be meant: each was read as a frame (reading.fps=...)."
        )
    elif fps and abs(rate / fps - 1) > NEAR:
        notes.append(f"The archive states {fps:g} frames a second, and its samples are {rate:g} a second: these were read.")
    return Frames(np.arange(count) + int(number), (start + np.arange(count)) * period, _common(rate), source, tuple(notes))


def _acyclic(sampling: Sampling, fps: float | None) -> Frames | None:
    """The whole frames between the first and the last of listed times."""
    times = np.unique(sampling.times)
    if len(times) < 2:
        return None
    rate = fps or _common(1 / float(np.median(np.diff(times))))
    first, last = np.ceil(times[0] * rate - NEAR), np.floor(times[-1] * rate + NEAR)
    if not (SLOWEST <= rate <= FASTEST and 0 <= last - first < MOST_SAMPLES and abs(first) < 2**53):
        return None
    numbers = np.arange(first, last + 1)
    source = "FramesPerTimeUnit of the archive" if fps else "the spacing of its samples"
    note = f"Its {len(times)} samples stand at listed times: {rate:g} frames a second were read between them (reading.fps=...)."
    return Frames(numbers.astype(np.int64), numbers / rate, rate, source, (note,))


def _common(rate: float) -> float:
    """A rate, or the common one that it is but for rounding."""
    return next((common for common in COMMON_RATES if abs(rate / common - 1) < 1e-4), rate)


def _read(file: BinaryIO) -> tuple[list[Sampling], float | None]:
    """The samplings of an archive, and the frames a second in its metadata.

    Raises:
        ValueError: it is none, or damaged.
    """
    size = file.seek(0, 2)
    head = _bytes(file, 0, 16, size)
    if head[:5] != b"Ogawa":
        raise ValueError("no Ogawa archive")
    root = struct.unpack_from("<Q", head, 8)[0]
    (count,) = struct.unpack("<Q", _bytes(file, root, 8, size))
    if not SAMPLINGS < count <= MOST_CHILDREN:
        raise ValueError("no root group")
    children = struct.unpack(f"<{count}Q", _bytes(file, root + 8, 8 * count, size))
    match = re.search(rb"(?:^|;)(?:FramesPerTimeUnit|[^;=]*FPS)=([0-9.]+)", _data(file, children[METADATA], size))
    fps = float(match[1]) if match else 0.0
    samplings = _samplings(_data(file, children[SAMPLINGS], size))
    if any(sampling.count > max(HELD_SAMPLES, size // 8) for sampling in samplings):
        raise ValueError("more samples than the file could hold")
    return samplings, fps if SLOWEST <= fps <= FASTEST else None


def _samplings(data: bytes) -> list[Sampling]:
    found, at = [], 0
    while at < len(data):
        count, period, listed = struct.unpack_from("<IdI", data, at)
        times = np.frombuffer(data, "<f8", listed, at + 16)
        at += 16 + 8 * listed
        if not (listed and np.isfinite(times).all() and period > 0 and count <= MOST_SAMPLES):
            raise ValueError("damaged sampling")
        found.append(Sampling(count, period, times))
    return found


def _data(file: BinaryIO, child: int, size: int) -> bytes:
    position = child & ~IS_DATA
    if not child & IS_DATA or not position:
        return b""
    (length,) = struct.unpack("<Q", _bytes(file, position, 8, size))
    return _bytes(file, position + 8, length, size)


def _bytes(file: BinaryIO, position: int, count: int, size: int) -> bytes:
    if position + count > size:
        raise ValueError("positions beyond the end of the file")
    file.seek(position)
    return file.read(count)
