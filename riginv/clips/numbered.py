"""Sequences with one file per frame: the files that a path names, and the frame number of each."""

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.frame_names import frame_position, group, pattern_of, sequence_of
from riginv.errors import InputError, counted, listed

# Placeholders of the frame number in a pattern; the first kind that occurs in a name is the one meant.
PLACEHOLDERS = tuple(
    re.compile(placeholder, re.IGNORECASE)
    for placeholder in (r"%0?\d*d", r"\$F\d*", r"<f(?:rame)?\d*>|\{f(?:rame)?(?::0?\d*d?)?\}", r"(?<!\d)#+(?!\d)")
)
LONGEST_GAP = 100_000  # frames
LARGEST_NUMBER = 2**53  # of a frame


class FrameFiles(NamedTuple):
    """The files of a sequence.

    Attributes:
        numbers: frame numbers `(frame,)`, rising.
        paths: of each frame; None where its file is missing.
        notes: sentences: what was left out or guessed.
    """

    numbers: np.ndarray
    paths: list[Path | None]
    notes: tuple[str, ...] = ()

    @property
    def first(self) -> Path:
        return next(path for path in self.paths if path is not None)


def is_pattern(path: str) -> bool:
    """Whether a path is a pattern for several files."""
    return any(mark in path for mark in "*?") or any(kind.search(Path(path).name) for kind in PLACEHOLDERS)


def visible_files(folder: Path) -> list[Path]:
    """The files in a folder by name, without hidden ones such as `._f.1.obj` and `.DS_Store` of macOS.

    Raises:
        InputError: the folder cannot be read.
    """
    return [path for path in _files(folder) if not path.name.startswith(".")]


def find_frames(path: str, suffix: str, bridge: bool = False) -> FrameFiles:
    """The files that a path names: a folder, a glob, one file, or a pattern as `shot.%04d.obj`, `shot.####.obj`, `shot.$F4.obj`
    or `shot.<frame>.obj`.

    Without a pattern, the number that varies between names is the frame number. Files without a number are left out.

    Args:
        suffix: of the files, where the path is a folder.
        bridge: treat missing frames as unknown instead of refusing them.

    Raises:
        InputError: there are none, several sequences, two files of the same number, or some are missing between others.
    """
    location = Path(path)
    if location.is_file():
        return _one_file(location)
    if location.is_dir():
        files = [file for file in visible_files(location) if file.suffix.lower() == suffix]
        if not files:
            raise InputError(f"{path}: no frames: expected files ending in {suffix}, found none")
        return _in_order(path, files, bridge)
    kind = next((kind for kind in PLACEHOLDERS if kind.search(location.name)), None)
    if kind is not None:
        return _of_pattern(path, location, kind, bridge)
    names = [file.name for file in _of_same_kind(location)]
    for glob in (location.name, location.name.replace("[", "[[]")):  # brackets may be part of the name
        files = [location.parent / name for name in names if fnmatchcase(name, glob)]
        if files:
            return _in_order(path, files, bridge)
    expected = "files of that pattern" if is_pattern(path) or "[" in location.name else "a file of that name"
    raise InputError(f"{path}: no frames: expected {expected}, found none{_folder_missing(location)}")


def _one_file(given: Path) -> FrameFiles:
    """One file as a clip of one frame; a note names the pattern of files that differ from it by a number."""
    siblings = [file for file in visible_files(given.parent) if file.suffix.lower() == given.suffix.lower()]
    found = next(names for names in group([given, *siblings]) if any(name.path == given for name in names))
    names = list({name.path: name for name in found}.values())
    name = next(name for name in names if name.path == given)
    if not name.digits:
        return FrameFiles(np.array([0]), [given])
    try:
        position = frame_position(str(given), names)
    except InputError:
        position = len(name.digits) - 1
    notes: tuple[str, ...] = ()
    if len(names) > 1:
        pattern = pattern_of(names, position)
        notes = (f"One frame was read; {pattern} reads {counted(len(names) - 1, 'more file')} beside it, too.",)
    number = name.number(position)
    return FrameFiles(np.array([number if abs(number) < LARGEST_NUMBER else 0]), [given], notes)


def _of_pattern(path: str, given: Path, kind: re.Pattern, bridge: bool) -> FrameFiles:
    """The files of a pattern with a placeholder; of several placeholders, the one with matching files."""
    candidates = []
    for match in kind.finditer(given.name):
        before, after = given.name[: match.start()], given.name[match.end() :]
        whole = r"(?<!\d)" if before[-1:] in ("*", "?") else ""  # a wildcard takes no digits of the frame number
        name = re.compile(rf"{_literal(before)}{whole}(-?\d+){_literal(after)}", re.DOTALL)
        matches = [(file, found) for file in _of_same_kind(given) if (found := name.fullmatch(file.name))]
        if matches:
            candidates.append((match[0], matches))
    if not candidates:
        raise InputError(
            f"{path}: no frames: expected files as {given.name} in {given.parent}, found none{_folder_missing(given)}"
        )
    if len(candidates) > 1:
        raise InputError(
            f"{path}: {len(candidates)} placeholders in it fit as the frame number: write %d for the right one alone"
        )
    return _numbered(path, [(int(found[1]), file) for file, found in candidates[0][1]], bridge, ())


def _literal(text: str) -> str:
    """A part of a pattern as a regular expression: `*` and `?` are wildcards, all else is literal."""
    return re.escape(text).replace(r"\*", ".*").replace(r"\?", ".")


def _of_same_kind(given: Path) -> list[Path]:
    """The files in a pattern's folder; hidden ones too where the pattern starts with a dot."""
    return _files(given.parent) if given.name.startswith(".") else visible_files(given.parent)


def _folder_missing(given: Path) -> str:
    """The end of a sentence about files that are not there: that their folder is not, or which files of the kind it has."""
    if not given.parent.is_dir():
        return f": there is no folder {given.parent}"
    others = [file.name for file in _of_same_kind(given) if file.suffix.lower() == given.suffix.lower()]
    return f"; there are {listed(others)}" if others else ""


def _files(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if not path.is_dir()) if folder.is_dir() else []
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error}") from None


def _in_order(path: str, found: Sequence[Path], bridge: bool) -> FrameFiles:
    """Files in the order of the number that varies in their names."""
    sequence, others = sequence_of(path, found)
    if sequence is None:
        note = f"None of the {len(found)} names has a number: they were read in the order of their names, as frames from 0."
        return FrameFiles(np.arange(len(found)), list(found), (note,) if len(found) > 1 else ())
    notes: tuple[str, ...] = ()
    if others:
        notes = (f"Left out: {listed(file.name for file in others)}, not of the sequence {sequence.pattern}.",)
    if sequence.signed_pattern and len(sequence.files) > 1:
        notes += (
            f"The dash before the numbers was taken for a part of the name, not a minus ({sequence.signed_pattern}: a minus).",
        )
    numbered = [(name.number(sequence.position), name.path) for name in sequence.files]
    return _numbered(path, numbered, bridge, notes)


def _numbered(path: str, found: list[tuple[int, Path]], bridge: bool, notes: tuple[str, ...]) -> FrameFiles:
    by_number: dict[int, Path] = {}
    for number, file in found:
        if abs(number) >= LARGEST_NUMBER:
            raise InputError(f"{file}: its frame's number is beyond 2^53: rename the files in order")
        other = by_number.setdefault(number, file)
        if other is not file:
            raise InputError(f"{path}: {other.name} and {file.name} are the same frame: give a pattern that names one of them")
    numbers = np.array(sorted(by_number))
    steps = np.diff(numbers)
    if len(steps) and (steps != steps[0]).any():
        numbers = _with_missing(path, numbers, int(steps.min()), bridge)
        gone = len(numbers) - len(by_number)
        notes += (
            f"{counted(gone, 'frame')} {'has no file and is' if gone == 1 else 'have no file and are'} interpolated "
            "(reading.missing_frames=error refuses them).",
        )
    elif len(steps) and steps[0] > 1:
        notes += (f"There is a file at every {steps[0]} frames: time goes by their numbers.",)
    return FrameFiles(numbers, [by_number.get(int(number)) for number in numbers], notes)


def _with_missing(path: str, numbers: np.ndarray, step: int, bridge: bool) -> np.ndarray:
    """The numbers and those missing between them."""
    if (numbers[-1] - numbers[0]) // step > LONGEST_GAP + len(numbers):
        raise InputError(f"{path}: frames {numbers[0]} to {numbers[-1]} with {len(numbers)} files: rename them in order")
    full = np.union1d(np.arange(numbers[0], numbers[-1] + 1, step), numbers)
    missing = np.setdiff1d(full, numbers)
    if not bridge:
        every, verb = f" (one every {step})" if step > 1 else "", "is" if len(missing) == 1 else "are"
        raise InputError(
            f"{path}: {len(missing)} of frames {numbers[0]} to {numbers[-1]}{every} {verb} missing: {_spans(missing, step)}; "
            "add them, or interpolate them with reading.missing_frames=bridge"
        )
    return full


def _spans(numbers: np.ndarray, step: int) -> str:
    """Numbers for a message, consecutive ones as `first to last`."""
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) != step) + 1)
    spans = [f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs]
    return listed(spans)
