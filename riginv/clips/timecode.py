"""Timecodes of a recording: the frame number of each row, and the frame rate.

A timecode `HH:MM:SS:FF.fff` does not contain the number of frames per second; rows may be any number of these apart, and rows
may be missing. Both rates are estimated from all rows: the count from FF at the end of a second, the frame rate from the usual
step between two rows.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.frame_rate import COUNTS, frames_per_second
from riginv.errors import InputError

APP_COUNT = 60  # frames per second in timecodes of the Live Link Face app, at any recording rate
FRAMES = re.compile(r"(\d+)[:;](\d\d?)[:;](\d\d?)([:;])(\d+(?:[.,]\d+)?)")
SECONDS = re.compile(r"(\d+):(\d\d?):(\d\d?(?:[.,]\d+)?)")
DAY_S = 24 * 3600


class Timing(NamedTuple):
    """The frames of a recording.

    Attributes:
        frame_numbers: `(frame,)`, from 0, rising; missing rows leave gaps.
        kept: the row of each frame, `(frame,)`.
        fps: frames per second.
        rate_source: where that comes from.
        notes: what was guessed or skipped.
    """

    frame_numbers: np.ndarray
    kept: np.ndarray
    fps: float
    rate_source: str
    notes: list[str]


class Stamps(NamedTuple):
    """Timecodes as numbers `(row,)`: whole seconds since midnight, and frames (or the fraction of a second) after them."""

    seconds: np.ndarray
    frames: np.ndarray
    drop: bool
    in_seconds: bool


def timing(path: Path, timecodes: Sequence[str], lines: Sequence[int]) -> Timing:
    """The timing of rows with timecodes.

    Args:
        lines: line numbers in the file, for messages.

    Raises:
        InputError: a timecode cannot be parsed.
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
    frames = [match for timecode in timecodes if (match := FRAMES.fullmatch(timecode))]
    seconds = [match for timecode in timecodes if (match := SECONDS.fullmatch(timecode))]
    if len(frames) < len(timecodes) == len(seconds):
        parts = np.array([[float(part.replace(",", ".")) for part in match.groups()] for match in seconds])
        whole = np.floor(parts[:, 2])
        return Stamps(3600 * parts[:, 0] + 60 * parts[:, 1] + whole, parts[:, 2] - whole, False, True)
    if len(frames) < len(timecodes):
        row = next(row for row, timecode in enumerate(timecodes) if not FRAMES.fullmatch(timecode))
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
    """The number of frames that the timecodes count per second."""
    highest, change = float(frames.max()), np.diff(frames)
    steps, new_second = change[(np.diff(seconds) == 0) & (change > 0)], np.diff(seconds) == 1
    possible = np.array([count for count in COUNTS if count > highest])
    default = APP_COUNT if APP_COUNT in possible else int(possible[0])
    step = float(np.median(steps)) if len(steps) else 0.0
    counts = step - change[new_second]  # 58 + 2 - 0: the count, unless rows are missing there
    counts = counts[(np.abs(counts[:, None] - possible) <= max(1.0, step)).any(axis=1)]
    if not len(steps) or not len(counts):
        if np.ptp(frames) > 0:
            notes.append(
                f"the take is too short for its timecodes to show how many frames they count in a second: {default} taken"
                f"{', as the app counts' if default == APP_COUNT else ''} (reading.fps=... sets it)"
            )
        return default
    count = int(possible[np.abs(possible - np.median(counts)).argmin()])
    if count != APP_COUNT:
        notes.append(
            f"its timecodes count {count} frames a second, not {APP_COUNT} as the app's do: their highest frame is {highest:g}"
        )
    return count


def _times(seconds: np.ndarray, stamps: Stamps, count: float, notes: list[str]) -> tuple[np.ndarray, float]:
    """The time of each row in counts, and the counts per second.

    Drop-frame timecode (SMPTE 12M) skips the numbers 0 and 1 (at 60 per second 0 to 3) at the start of each minute but every
    tenth, so that 29.97 frames per second keep up with the clock.
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
    """Rising times and their rows: rows that repeat a timecode are left out, jumps back are removed."""
    rows = np.arange(len(time))
    change = np.diff(time)
    if len(time) > 1 and not change.any():
        notes.append(f"all {len(time):,} rows have one timecode: they were placed one after the other, {APP_COUNT} a second")
        return rows * rate / APP_COUNT, rows
    same = np.concatenate([[False], change == 0])
    first = np.flatnonzero(~same)
    repeats = np.diff(np.append(first, len(time)))
    usual = int(np.median(repeats))
    if usual > 1:
        notes.append(f"{usual} rows share each timecode: they were placed evenly between it and the next")
        fraction = (rows - np.repeat(first, repeats)) / np.repeat(np.maximum(repeats, usual), repeats)
        time, same = time + float(np.median(np.diff(time[first]))) * fraction, np.zeros(len(time), bool)
    elif same.any():
        line = lines[int(same.argmax())]
        notes.append(f"rows that repeat the timecode of the row above were left out: {same.sum():,}, the first in line {line}")
    kept = np.flatnonzero(~same)
    return _without_jumps(
        time[kept], [timecodes[row] for row in kept.tolist()], [lines[row] for row in kept.tolist()], notes
    ), kept


def _without_jumps(time: np.ndarray, timecodes: Sequence[str], lines: Sequence[int], notes: list[str]) -> np.ndarray:
    """Times without jumps back: the row after a jump follows the row before it at the usual step."""
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
