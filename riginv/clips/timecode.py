"""Timecodes of a recording's rows: which frame each row is, how many there are a second, and what does not fit.

A timecode `HH:MM:SS:FF.fff` counts some frames a second, and does not say how many; rows may lie any number of these apart, and
some may be missing. Both rates follow from all rows together: the count from what FF shows where a second ends, the rows' own
from the usual distance between two of them.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.frame_rate import COUNTS, frames_per_second
from riginv.errors import InputError

APP_COUNT = 60  # what the Live Link Face app counts, whatever it records at
FRAMES = re.compile(r"(\d+)[:;](\d\d?)[:;](\d\d?)([:;])(\d+(?:[.,]\d+)?)")
SECONDS = re.compile(r"(\d+):(\d\d?):(\d\d?(?:[.,]\d+)?)")
DAY_S = 24 * 3600


class Timing(NamedTuple):
    """When the rows of a recording were taken.

    Attributes:
        frame_numbers: `(row kept,)`, from 0, rising; rows that are missing leave gaps.
        kept: the rows that are frames of their own, `(row kept,)`.
        fps: frames a second.
        rate_source: where that comes from.
        notes: what was guessed or passed over.
    """

    frame_numbers: np.ndarray
    kept: np.ndarray
    fps: float
    rate_source: str
    notes: list[str]


class Stamps(NamedTuple):
    """Timecodes as numbers, `(row,)` each: whole seconds since midnight, and the frames (or the rest of the second) on top."""

    seconds: np.ndarray
    frames: np.ndarray
    drop: bool
    in_seconds: bool


def timing(path: Path, timecodes: Sequence[str], lines: Sequence[int]) -> Timing:
    """The timing of rows with timecodes.

    Args:
        lines: of the file, for messages.

    Raises:
        InputError: a timecode is none.
    """
    notes: list[str] = []
    stamps = _parsed(path, timecodes, lines)
    seconds = stamps.seconds + DAY_S * np.cumsum(np.diff(stamps.seconds, prepend=stamps.seconds[0]) < -DAY_S / 2)
    count = 1.0 if stamps.in_seconds else _count(seconds, stamps.frames, notes)
    time, rate = _times(seconds, stamps, count, notes)
    time, kept = _in_order(time, rate, timecodes, lines, notes)
    if len(time) < 2:
        return Timing(np.zeros(len(time), np.int64), kept, float(APP_COUNT), "what the app records at", notes)
    fps = frames_per_second(time, rate)
    numbers = np.round((time - time[0]) * fps / rate).astype(np.int64)
    row = np.arange(len(numbers))
    numbers = np.maximum.accumulate(numbers - row) + row
    missing = np.diff(numbers) - 1
    if missing.any():
        longest = int(missing.argmax())
        notes.append(
            f"rows are missing: {missing.sum():,} in all, at most {missing.max():,} one after the other (after "
            f"{timecodes[kept[longest]]}): the frame numbers have gaps there"
        )
    return Timing(numbers - numbers[0], kept, fps, "the usual distance of its timecodes", notes)


def _parsed(path: Path, timecodes: Sequence[str], lines: Sequence[int]) -> Stamps:
    frames = [FRAMES.fullmatch(timecode) for timecode in timecodes]
    if not all(frames) and all(found := [SECONDS.fullmatch(timecode) for timecode in timecodes]):
        parts = np.array([[float(part.replace(",", ".")) for part in match.groups()] for match in found])
        whole = np.floor(parts[:, 2])
        return Stamps(3600 * parts[:, 0] + 60 * parts[:, 1] + whole, parts[:, 2] - whole, False, True)
    if not all(frames):
        row = frames.index(None)
        raise InputError(
            f"{path}, line {lines[row]}, column Timecode: found {timecodes[row][:60]!r}, expected HH:MM:SS:FF.fff (hours, "
            f"minutes, seconds, frames), or HH:MM:SS;FF for drop-frame"
        )
    parts = np.array([[float(match[part].replace(",", ".")) for part in (1, 2, 3, 5)] for match in frames])
    wrong = (parts[:, 0] >= 24) | (parts[:, 1] >= 60) | (parts[:, 2] >= 60) | (parts[:, 3] >= max(COUNTS))
    if wrong.any():
        row = int(wrong.argmax())
        raise InputError(
            f"{path}, line {lines[row]}, column Timecode: found {timecodes[row][:60]!r}, which is no time of a day"
        )
    return Stamps(parts[:, :3] @ [3600, 60, 1], parts[:, 3], any(match[4] == ";" for match in frames), False)


def _count(seconds: np.ndarray, frames: np.ndarray, notes: list[str]) -> float:
    """How many frames the timecodes count in a second."""
    most, change = float(frames.max()), np.diff(frames)
    steps, turned = change[(np.diff(seconds) == 0) & (change > 0)], np.diff(seconds) == 1
    able = np.array([count for count in COUNTS if count > most])
    default = APP_COUNT if APP_COUNT in able else int(able[0])
    step = float(np.median(steps)) if len(steps) else 0.0
    shown = step - change[turned]  # 58 + 2 - 0: the count, unless rows are missing just there
    shown = shown[(np.abs(shown[:, None] - able) <= max(1.0, step)).any(axis=1)]
    if not len(steps) or not len(shown):
        if np.ptp(frames) > 0:
            notes.append(
                f"the take is too short for its timecodes to show how many frames they count in a second: {default} taken"
                f"{', as the app counts' if default == APP_COUNT else ''} (reading.fps=... says otherwise)"
            )
        return default
    count = int(able[np.abs(able - np.median(shown)).argmin()])
    if count != APP_COUNT:
        notes.append(
            f"its timecodes count {count} frames a second, not {APP_COUNT} as the app's do: their highest frame is {most:g}"
        )
    return count


def _times(seconds: np.ndarray, stamps: Stamps, count: float, notes: list[str]) -> tuple[np.ndarray, float]:
    """The time of each row in counts, and how many of them are a second.

    Drop-frame timecode (SMPTE 12M) leaves out the numbers 0 and 1 (at 60 a second 0 to 3) at the start of each minute but every
    tenth, so that 29.97 frames a second keep up with the clock.
    """
    time = count * seconds + stamps.frames
    if not stamps.drop or count % 30:
        return time, count
    minutes, dropped, rate = seconds // 60, count / 15, count * 1000 / 1001
    impossible = (minutes % 10 != 0) & (seconds % 60 == 0) & (stamps.frames < dropped)
    if impossible.any():
        notes.append("its timecodes are marked as drop-frame (;), and hold frames that drop-frame leaves out: all were counted")
        return time, rate
    return time - dropped * (minutes - minutes // 10), rate


def _in_order(
    time: np.ndarray, rate: float, timecodes: Sequence[str], lines: Sequence[int], notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Rising times, and the rows that they are of: rows that repeat a timecode are left out, jumps back are closed."""
    rows = np.arange(len(time))
    change = np.diff(time)
    if len(time) > 1 and not change.any():
        notes.append(f"all {len(time):,} rows have one timecode: they were placed one after the other, {APP_COUNT} a second")
        return rows * rate / APP_COUNT, rows
    same = np.concatenate([[False], change == 0])
    first = np.flatnonzero(~same)
    each = np.diff(np.append(first, len(time)))
    usual = int(np.median(each))
    if usual > 1:
        notes.append(f"{usual} rows share each timecode: they were placed evenly between it and the next")
        place = (rows - np.repeat(first, each)) / np.repeat(np.maximum(each, usual), each)
        time, same = time + float(np.median(np.diff(time[first]))) * place, np.zeros(len(time), bool)
    elif same.any():
        line = lines[int(same.argmax())]
        notes.append(f"rows that repeat the timecode of the row above were left out: {same.sum():,}, the first in line {line}")
    kept = np.flatnonzero(~same)
    return _closed(time[kept], [timecodes[row] for row in kept], [lines[row] for row in kept], notes), kept


def _closed(time: np.ndarray, timecodes: Sequence[str], lines: Sequence[int], notes: list[str]) -> np.ndarray:
    """Times without their jumps back: rows after one follow those before it at the usual distance."""
    change = np.diff(time)
    back = np.flatnonzero(change < 0)
    if not len(back):
        return time
    step = float(np.median(change[change > 0])) if (change > 0).any() else 1.0
    more = f", and {len(back) - 1:,} times more" if len(back) > 1 else ""
    notes.append(
        f"the timecode goes back in line {lines[back[0] + 1]}, from {timecodes[back[0]]} to {timecodes[back[0] + 1]}{more}: "
        f"the rows from there on were placed after those above"
    )
    return np.concatenate([[0.0], np.cumsum(np.where(change < 0, step, change))])
