"""One file for each frame: which files a pattern names, and which frame each is."""

import re
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.errors import InputError

PLACE = re.compile(r"%(0?)(\d*)d|#+")
NUMBER = re.compile(r"\d+")
SHOWN = 6  # missing frames that a message names
LONGEST_GAP = 100_000  # frames; more is no gap but another numbering


class FrameFiles(NamedTuple):
    """The files of a sequence.

    Attributes:
        numbers: of the frames, `(frame,)`, rising.
        paths: of each frame, None where its file is missing.
    """

    numbers: np.ndarray
    paths: list[Path | None]

    @property
    def first(self) -> Path:
        return next(path for path in self.paths if path is not None)


def is_pattern(path: str) -> bool:
    """Whether a path stands for several files."""
    return any(mark in path for mark in "*?#[") or bool(PLACE.search(path))


def find_frames(path: str, suffixes: tuple[str, ...], bridge: bool = False) -> FrameFiles:
    """The files that a path names: a folder, a glob, a pattern as `shot.%04d.obj` or `shot.####.obj`, or one file.

    Args:
        suffixes: the endings of the files that are meant, where a folder is named.
        bridge: let missing frames count as unknown.

    Raises:
        InputError: there are none, two of the same number, or some are missing between others.
    """
    given = Path(path)
    if given.is_file():
        return FrameFiles(np.array([_number(given.stem, 0)]), [given])
    if given.is_dir():
        found = sorted(file for file in _inside(given) if file.suffix.lower() in suffixes and not file.name.startswith("."))
        expected = f"files ending in {' or '.join(suffixes)}"
    elif match := PLACE.search(given.name):
        found = _numbered(given, match)
        expected = f"files as {given.name} in {given.parent}"
    else:
        found = sorted(file for file in _inside(given.parent) if fnmatchcase(file.name, given.name) and file.is_file())
        expected = "files of that pattern"
    if not found:
        raise InputError(f"{path}: no frames: expected {expected}, found none")
    return _in_order(path, found, bridge)


def _numbered(given: Path, place: re.Match) -> list[Path]:
    before, after = re.escape(given.name[: place.start()]), re.escape(given.name[place.end() :])
    name = re.compile(before + r"\d+" + after)
    return sorted(file for file in _inside(given.parent) if name.fullmatch(file.name))


def _inside(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise InputError(f"{folder}: cannot be looked into: {error}") from None


def _number(stem: str, otherwise: int) -> int:
    numbers = NUMBER.findall(stem)
    return int(numbers[-1]) if numbers and len(numbers[-1]) <= 15 else otherwise


def _in_order(path: str, found: list[Path], bridge: bool) -> FrameFiles:
    if any(NUMBER.search(file.stem) is None for file in found):
        return FrameFiles(np.arange(len(found)), list(found))  # by name
    by_number: dict[int, Path] = {}
    for file in found:
        other = by_number.setdefault(_number(file.stem, 0), file)
        if other is not file:
            raise InputError(f"{path}: {other.name} and {file.name} are the same frame: give a pattern that names one of them")
    numbers = np.array(sorted(by_number))
    steps = np.diff(numbers)
    if len(steps) and (steps != steps[0]).any():
        step = int(steps.min())
        if (numbers[-1] - numbers[0]) // step > LONGEST_GAP + len(numbers):
            raise InputError(f"{path}: frames {numbers[0]} to {numbers[-1]} with {len(numbers)} files: rename them in order")
        full = np.union1d(np.arange(numbers[0], numbers[-1] + 1, step), numbers)
        missing = np.setdiff1d(full, numbers)
        if not bridge:
            shown = ", ".join(map(str, missing[:SHOWN])) + (", ..." if len(missing) > SHOWN else "")
            raise InputError(
                f"{path}: {len(missing)} of frames {numbers[0]} to {numbers[-1]} are missing: {shown}; add them, or let their "
                f"neighbours stand in with reading.missing_frames=bridge"
            )
        numbers = full
    return FrameFiles(numbers, [by_number.get(int(number)) for number in numbers])
