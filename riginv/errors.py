"""Exceptions with messages for users."""

import unicodedata
from collections.abc import Iterable

CONTROL_CATEGORIES = ("Cc", "Cs", "Zl", "Zp")  # Unicode categories of control characters, surrogates and line separators


class InputError(ValueError):
    """Something that the user gave is wrong: commands show the message as one sentence, without a traceback.

    The message names the file or the field, what was found, what was expected, and what to do.
    """


class NonFiniteLossError(RuntimeError):
    """The training loss became NaN or infinite; the message names the step."""


def listed(names: Iterable[object], most: int | None = 8) -> str:
    """Names separated by commas, at most `most` of them (None: all), and how many more there are; `none` without any."""
    texts = list(map(str, names))
    more = f" and {len(texts) - most:,} more" if most is not None and len(texts) > most else ""
    return ", ".join(texts[:most]) + more if texts else "none"


def counted(count: int, one: str, many: str | None = None) -> str:
    """A number with its noun: `1 frame`, `2 frames`; `many` where the plural is not made by an s."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def in_short(error: BaseException, most: int = 150) -> str:
    """An exception's message in one line, cut to `most` characters."""
    return " ".join(str(error).split())[:most] or type(error).__name__


def printable(text: str) -> str:
    """A text of a file as it can be printed in one line."""
    return "".join("?" if unicodedata.category(letter) in CONTROL_CATEGORIES else letter for letter in text)
