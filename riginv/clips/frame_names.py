"""Numbers in file names: which one is the frame number, and which files form a sequence."""

import re
import shlex
from collections.abc import Sequence, Set
from pathlib import Path
from typing import NamedTuple

from riginv.errors import InputError, listed

NUMBER = re.compile(r"(?:(?<=[._-])-|^-)?\d+")  # a minus follows another separator: f.-3, f_-3, f--3; in f-3 it is none
LISTED = 4  # patterns in a message


class FileName(NamedTuple):
    """A file name split at its numbers.

    Attributes:
        path: of the file.
        texts: the texts around the numbers, one more than there are numbers, the suffix included.
        digits: the numbers as written, with their signs.
    """

    path: Path
    texts: tuple[str, ...]
    digits: tuple[str, ...]

    @property
    def kind(self) -> tuple[str, ...]:
        """The texts, lower case: equal for all files of a sequence."""
        return tuple(text.casefold() for text in self.texts)

    def number(self, position: int) -> int:
        return int(self.digits[position])


class NumberedFiles(NamedTuple):
    """The files of a sequence.

    Attributes:
        files: in any order.
        position: index of the frame number among the numbers of a name.
    """

    files: list[FileName]
    position: int

    @property
    def pattern(self) -> str:
        return pattern_of(self.files, self.position)

    @property
    def signed_pattern(self) -> str:
        """The pattern that takes the dash before every number as a minus; empty where there is no dash."""
        if not self.files[0].texts[self.position].endswith("-"):
            return ""
        return pattern_of([_negative(name, self.position) for name in self.files], self.position)


def parse_name(path: Path) -> FileName:
    """Split a name at its numbers."""
    stem, texts, digits, end = path.stem, [], [], 0
    for match in NUMBER.finditer(stem):
        texts.append(stem[end : match.start()])
        digits.append(match[0])
        end = match.end()
    return FileName(path, (*texts, stem[end:] + path.suffix), tuple(digits))


def group(files: Sequence[Path]) -> list[list[FileName]]:
    """Files grouped by names that differ only in numbers, largest group first; `f-1` is negative if `f1` exists."""
    groups: dict[tuple[str, ...], list[FileName]] = {}
    for file in files:
        name = parse_name(file)
        groups.setdefault(name.kind, []).append(name)
    for kind in [kind for kind in groups if any(text.endswith("-") for text in kind[:-1])]:
        for position, text in enumerate(kind[:-1]):
            positive = (*kind[:position], text.removesuffix("-"), *kind[position + 1 :])
            if text.endswith("-") and positive in groups:
                groups[positive] += [_negative(name, position) for name in groups.pop(kind)]
                break
    return sorted(groups.values(), key=len, reverse=True)


def _negative(name: FileName, position: int) -> FileName:
    texts, digits = list(name.texts), list(name.digits)
    texts[position] = texts[position].removesuffix("-")
    digits[position] = f"-{digits[position]}"
    return FileName(name.path, tuple(texts), tuple(digits))


def frame_position(path: str, names: list[FileName]) -> int:
    """The index of the frame number in a group's names: the number that varies.

    Raises:
        InputError: several vary; the message suggests patterns.
    """
    count = len(names[0].digits)
    varying = [position for position in range(count) if len({name.number(position) for name in names}) > 1]
    if len(varying) < 2:
        return varying[0] if varying else count - 1
    if all(len({name.number(position) for position in varying}) == 1 for name in names):
        return varying[-1]  # the same number twice
    most = max(varying, key=lambda position: (len({name.number(position) for name in names}), position))
    others = [position for position in varying if position != most]
    by_others: dict[tuple[int, ...], list[FileName]] = {}
    for name in names:
        by_others.setdefault(tuple(name.number(position) for position in others), []).append(name)
    largest = sorted(by_others.values(), key=len, reverse=True)
    if len(largest[0]) > 1:
        patterns = [pattern_of(some, most) for some in largest[:LISTED]]
    else:
        patterns = [pattern_of(names, position, set(varying) - {position}) for position in varying]
    raise InputError(
        f"{path}: {len(varying)} numbers vary in the names of its {len(names)} files ({names[0].path.name}, "
        f"{names[1].path.name}, ...), and only one can count frames: give {_one_of(patterns)}"
    )


def pattern_of(names: list[FileName], position: int, any_of: Set[int] = frozenset()) -> str:
    """The pattern of files, quoted for a shell: `'shot/f.%04d.obj'`.

    Args:
        position: index of the frame number.
        any_of: indices of numbers that `*` replaces.
    """
    first, pattern = names[0], ""
    for number, text in enumerate(first.texts):
        pattern += text
        if number < len(first.digits):
            written = [name.digits[number].lstrip("-") for name in names]
            padded = len({len(digits) for digits in written}) == 1 and any(digits[0] == "0" for digits in written)
            placeholder = f"%0{len(written[0])}d" if padded and len(written[0]) > 1 else "%d"
            pattern += placeholder if number == position else "*" if number in any_of else first.digits[number]
    return shlex.quote(str(first.path.parent / pattern))


def sequence_of(path: str, files: Sequence[Path]) -> tuple[NumberedFiles | None, list[Path]]:
    """The sequence among files (None where no name has a number), and the files that are not part of it.

    Raises:
        InputError: there are several sequences, or more other files than frames.
    """
    groups = [names for names in group(files) if names[0].digits]
    if not groups:
        return None, []
    main, *rest = groups
    takes = [main, *(names for names in rest if len(names) > 1)]
    if len(takes) > 1:
        patterns = [pattern_of(names, frame_position(path, names)) for names in takes[:LISTED]]
        raise InputError(f"{path}: {len(takes)} sequences are in one folder: give {_one_of(patterns)}")
    frames = {name.path for name in main}
    others = [file for file in files if file not in frames]
    found = NumberedFiles(main, frame_position(path, main))
    _check_dash(path, found)
    if len(others) >= len(main):
        raise InputError(
            f"{path}: {len(main)} files as {found.pattern} and {len(others)} others "
            f"({listed(file.name for file in others)}): which are the frames? give "
            f"{_one_of([found.pattern])}, or one with * for what varies beside the frame's number"
        )
    return found, others


def _check_dash(path: str, found: NumberedFiles) -> None:
    """Raise InputError where the dash after a space may be a minus or part of the name."""
    if found.files[0].texts[found.position].endswith(" -") and len(found.files) > 1:
        raise InputError(
            f"{path}: a dash precedes the number of every frame ({found.files[0].path.name}, ...): give {found.pattern} "
            f"where it is part of the name, or {found.signed_pattern} where it is a minus"
        )


def _one_of(patterns: Sequence[str]) -> str:
    return " or ".join(patterns) if len(patterns) > 1 else f"the pattern {patterns[0]}"
