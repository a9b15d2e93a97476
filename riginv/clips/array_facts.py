"""The arrays beside the vertices in an .npz: faces, frame rate, times, frame numbers."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from riginv.clips.times import FrameTimes, frames_from_times
from riginv.errors import InputError
from riginv.meshes.polygons import Polygons
from riginv.meshes.text_numbers import number_of
from riginv.runs.files import opened


def read_numbers(path: Path, dtype: np.dtype, shape: tuple[int, ...], offset: int) -> np.ndarray:
    """An array of a file's raw numbers, which start at byte `offset`.

    Raises:
        InputError: the file is too short, or cannot be read.
    """
    values = np.empty(shape, dtype)
    with opened(path) as file:
        file.seek(offset)
        found = file.readinto(values.view(np.uint8).data) if values.size else 0  # type: ignore[attr-defined]  # of files
    if found < values.nbytes:
        raise InputError(f"{path}: it ends {values.nbytes - found} bytes early: truncated; copy it or export it again")
    return values


FACES = ("faces", "triangles", "tris")
RATES = ("fps", "frame_rate", "framerate", "mocap_framerate", "mocap_frame_rate")
TIMES = ("times", "time", "timestamps")
NUMBERS = ("frame_numbers",)
METADATA = (*FACES, *RATES, *TIMES, *NUMBERS)
FRACTION = re.compile(r"([\d.]+)\s*/\s*([\d.]+)")
SAME_RATE = 1e-3  # relative difference below which two rates are the same

Arrays = Mapping[str, np.ndarray]


def faces_of(path: Path, arrays: Arrays) -> Polygons | None:
    """The faces; None where there are none.

    Raises:
        InputError: the array is something else.
    """
    name = next((name for name in FACES if name in arrays), None)
    if name is None or not arrays[name].size:
        return None
    faces = arrays[name]
    if faces.ndim != 2 or faces.shape[1] < 3 or faces.dtype.kind not in "iu":
        raise InputError(f"{path}: {name} are {faces.dtype} of shape {faces.shape}, expected whole numbers (face, 3)")
    with np.errstate(over="ignore"):
        corners = faces.astype(np.int64)
    return Polygons(np.full(len(faces), faces.shape[1], np.int64), corners.reshape(-1))


def frame_times(path: Path, arrays: Arrays, count: int, notes: list[str]) -> FrameTimes:
    """Frame numbers and frame rate; contradictions between arrays are added to `notes`.

    Raises:
        InputError: an array does not hold what its name promises.
    """
    fps, source = _rate(path, arrays)
    found = _from_times(path, arrays, count)
    notes.extend(found.notes)
    numbers = _numbers(path, arrays, count)
    if fps is None:
        return found._replace(numbers=found.numbers if numbers is None else numbers)
    if found.fps and not abs(found.fps - fps) <= SAME_RATE * abs(fps):
        notes.append(f"{source} is {fps:g}, and {found.rate_source} give {found.fps:g} frames a second: {source} was taken.")
        found = FrameTimes(np.arange(count))
    return FrameTimes(found.numbers if numbers is None else numbers, fps, f"its array {source}")


def _from_times(path: Path, arrays: Arrays, count: int) -> FrameTimes:
    """Frame numbers and rate of an array of times, where there is one."""
    name = next((name for name in TIMES if name in arrays), None)
    if name is None:
        return FrameTimes(np.arange(count))
    times = arrays[name]
    if times.size != count or times.dtype.kind not in "iuf":
        raise InputError(
            f"{path}: {name} are {times.dtype} of shape {times.shape}, expected a number for each of {count} frames"
        )
    return frames_from_times(times.reshape(-1) if times.dtype.kind == "f" else times.reshape(-1).astype(np.float64), name)


def _rate(path: Path, arrays: Arrays) -> tuple[float | None, str]:
    """Frames per second, and the name of the array: a number, or a text such as `24`, `29.97 fps` or `30000/1001`."""
    name = next((name for name in RATES if name in arrays), None)
    if name is None:
        return None, ""
    value = arrays[name]
    if value.size == 1 and value.dtype.kind in "iuf":
        return float(value.reshape(-1)[0]), name
    text = _text(value)
    if text is not None:
        text = text.strip().lower().removesuffix("fps").removesuffix("hz").strip()
        fraction = FRACTION.fullmatch(text)
        top, bottom = (number_of(part) for part in (fraction.groups() if fraction else (text, "1")))
        if top is not None and bottom:
            return top / bottom, name
    found = repr(text)[:60] if text is not None else f"{value.dtype} of shape {value.shape}"
    raise InputError(f"{path}: {name} is {found}, expected one number: save it as {name}=24.0, or give reading.fps=...")


def _text(value: np.ndarray) -> str | None:
    if value.size != 1 or value.dtype.kind not in "US":
        return None
    item = value.reshape(-1)[0]
    return item.decode("utf-8", "replace") if isinstance(item, bytes) else str(item)


def _numbers(path: Path, arrays: Arrays, count: int) -> np.ndarray | None:
    numbers = arrays.get(NUMBERS[0])
    if numbers is None:
        return None
    with np.errstate(invalid="ignore"):
        whole = numbers.dtype.kind in "iu" or (numbers.dtype.kind == "f" and bool((numbers == np.round(numbers)).all()))
    if numbers.size != count or not whole or (count and np.abs(numbers.astype(np.float64)).max() > 2**53):
        raise InputError(
            f"{path}: frame_numbers are {numbers.dtype} of shape {numbers.shape}, expected a whole number for each of {count} "
            f"frames"
        )
    return numbers.reshape(-1).astype(np.int64)
