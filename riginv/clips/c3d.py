"""The reader of C3D files of markers. Source: the C3D file format user guide, https://www.c3d.org.

Every count is compared with the file's size. The library ezc3d, which the tests write files with, ends the whole process at
some damaged files.
"""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.markers import MarkerClip, is_unnamed, positive_rate, unit_in_mm, unnamed_note, without_gaps
from riginv.clips.sequence import SourceFacts
from riginv.errors import InputError, printable
from riginv.runs.files import read_bytes

BLOCK = 512  # bytes
SIGNATURE = 0x50  # second byte of the file
ORDERS = {84: "<", 86: ">"}  # by processor type; 85, DEC, has floats of its own
TYPES = {-1: "S1", 1: "u1", 2: "i2", 4: "f4"}  # of parameters
MOST_FRAMES = 65_535  # in the header; longer takes have their length in parameters

Parameters = dict[str, np.ndarray]  # `POINT:LABELS` and so on; texts as one string each


class Header(NamedTuple):
    """The header of a C3D file.

    Attributes:
        order: byte order, `<` or `>`.
        points, analog: values of a frame: markers, and analogue samples of all channels.
        first, last: frame numbers.
        scale: of coordinates in 16 bits; 0 or less where they are floats.
        start: byte at which the frames start.
        rate: frames per second.
    """

    order: str
    points: int
    analog: int
    first: int
    last: int
    scale: float
    start: int
    rate: float


def read_c3d(path: Path) -> MarkerClip:
    """The markers of a C3D file.

    Raises:
        InputError: the file is damaged or holds no markers.
    """
    data = read_bytes(path)
    header, values = _header(path, data)
    if not header.points:
        raise InputError(f"{path}: a C3D file without points (it may hold analogue channels alone): export the markers, too")
    labels = [label for key in ("LABELS", *(f"LABELS{n}" for n in range(2, 10))) for label in _texts(values, f"POINT:{key}")]
    labels = [*labels[: header.points], *(f"*{number}" for number in range(len(labels), header.points))]
    columns = [number for number, label in enumerate(labels) if not is_unnamed(label)]
    if not columns:
        raise InputError(f"{path}: none of its {header.points} points has a name: label them, and export the take again")
    first, points, notes = _frames(path, data, header, values)
    points, frame_notes = without_gaps(points[:, columns])
    unnamed = unnamed_note(len(columns), header.points)
    unit, unit_notes = unit_in_mm(path, "".join(_texts(values, "POINT:UNITS")[:1]))
    facts = SourceFacts("C3D markers", rate_source="its header", notes=(*notes, *frame_notes, *unnamed, *unit_notes))
    names = tuple(printable(labels[number]) for number in columns)
    rate = positive_rate(header.rate)
    up = "".join(_texts(values, "POINT:Y_SCREEN")[:1]).lstrip("+").lower()  # the axis that is up on a screen
    up_axis = up if up in ("x", "y", "z") else None
    return MarkerClip(str(path), names, points, first + np.arange(len(points)), facts, rate, unit, up_axis)


def _header(path: Path, data: bytes) -> tuple[Header, Parameters]:
    start = BLOCK * (data[0] - 1) if data else 0
    if len(data) < 2 * BLOCK or data[1] != SIGNATURE or not 0 < start <= len(data) - BLOCK:
        raise InputError(
            f"{path}: no C3D file, or a damaged one: its first bytes are not those of a C3D header: export it again"
        )
    order = ORDERS.get(data[start + 3], "")
    if not order:
        raise InputError(f"{path}: processor type {data[start + 3]}, expected 84 (Intel) or 86 (MIPS): convert the file")
    points, analog, first, last = struct.unpack_from(f"{order}HHHH", data, 2)
    scale, begin, _, rate = struct.unpack_from(f"{order}fHHf", data, 12)
    if begin < 2 or BLOCK * (begin - 1) >= len(data) or np.isnan(scale):
        raise InputError(f"{path}: its frames start at block {begin}, which its {len(data)} bytes do not hold: export it again")
    return Header(order, points, analog, first, last, scale, BLOCK * (begin - 1), rate), _parameters(
        path, data, start + 4, order
    )


def _parameters(path: Path, data: bytes, at: int, order: str) -> Parameters:
    """All parameters, by `GROUP:NAME`."""
    damaged = InputError(f"{path}: a damaged C3D file: its parameters do not lie within its {len(data)} bytes: export it again")
    groups: dict[int, str] = {}
    values: dict[tuple[int, str], np.ndarray] = {}
    while at + 2 <= len(data):
        length, group = struct.unpack_from("<bb", data, at)
        after = at + 2 + abs(length)
        if not length or not group:
            break
        if after + 4 > len(data):
            raise damaged
        name = data[at + 2 : after].decode("latin-1").upper()
        offset = struct.unpack_from(f"{order}h", data, after)[0]
        if group < 0:
            groups[-group] = name
        else:
            value = _parameter(data, after + 2, order)
            if value is None:
                raise damaged
            values[group, name] = value
        if offset <= 0:
            break
        at = after + offset
    return {f"{groups.get(group, '')}:{name}": value for (group, name), value in values.items()}


def _parameter(data: bytes, at: int, order: str) -> np.ndarray | None:
    """The values of a parameter, flat, or its texts; None where they do not lie within the file."""
    kind, dimensions = struct.unpack_from("<bB", data, at)
    shape = list(data[at + 2 : at + 2 + dimensions])
    if kind not in TYPES or len(shape) < dimensions or dimensions > 7:
        return None
    count, begin = int(np.prod(shape, dtype=float)), at + 2 + dimensions
    dtype = np.dtype(f"{order}{TYPES[kind]}")
    if begin + count * dtype.itemsize > len(data):
        return None
    if kind != -1:
        return np.frombuffer(data, dtype, count, begin)
    width, end = shape[0] if shape else 1, begin + count
    cells = [data[first : min(first + width, end)] for first in range(begin, end, max(width, 1))]
    return np.array([cell.decode("utf-8", "replace").strip("\0 ") for cell in cells], dtype=str)


def _texts(found: Parameters, key: str) -> list[str]:
    values = found.get(key)
    return [] if values is None or values.dtype.kind != "U" else [str(value) for value in values]


def _frames(path: Path, data: bytes, header: Header, found: Parameters) -> tuple[int, np.ndarray, tuple[str, ...]]:
    """The first frame number, points `(frame, marker, 3)` with NaN in gaps, and notes."""
    is_float = header.scale <= 0
    width = 4 * header.points + header.analog
    dtype = np.dtype(f"{header.order}{'f4' if is_float else 'i2'}")
    there = (len(data) - header.start) // (width * dtype.itemsize)
    first, last = header.first, header.last
    ends = [_long(found.get(f"TRIAL:ACTUAL_{end}_FIELD")) for end in ("START", "END")]
    if ends[0] is not None and ends[1] is not None and ends[1] - ends[0] > last - first:
        first, last = ends[0], ends[1]
    promised = last - first + 1
    count = there if promised >= MOST_FRAMES and ends[1] is None else min(promised, there)
    if count < 1:
        raise InputError(f"{path}: its header promises {promised} frames, and its {len(data)} bytes hold none: export it again")
    notes = (f"it is cut short: {count} of {promised} frames are there.",) if count < promised else ()
    frames = np.frombuffer(data, dtype, count * width, header.start).reshape(count, width)
    values = frames[:, : 4 * header.points].reshape(count, header.points, 4).astype(np.float32)
    points = values[..., :3] if is_float else values[..., :3] * header.scale
    good = (values[..., 3] >= 0) & (np.abs(points) < 1e30).all(axis=2)
    return first, np.where(good[..., None], points, np.nan), notes


def _long(values: np.ndarray | None) -> int | None:
    """A frame number of two words of 16 bits, the low one first."""
    if values is None or values.dtype.kind != "i" or len(values) != 2:
        return None
    return int(values[0]) % 65_536 + 65_536 * (int(values[1]) % 65_536)
