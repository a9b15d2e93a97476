"""Numbers as programs write them into text: what is one, what can be mended, and why something else is none.

NaN and infinity stand in many spellings: `nan`, `-nan(ind)`, `1.#IND00` (Microsoft's C library before 2015), `Infinity`. All of
them are NaN here: not known. Fortran writes exponents with D or Q: `1.0D+02`. Both are safe to read. Decimal commas and
separators of thousands are not: `1,234` may be either.
"""

import re
import warnings
from typing import NamedTuple

import numpy as np

DIGITS = rb"(?:\d+(?:\.\d*)?|\.\d+)"
NUMBER = re.compile(rb"[+-]?" + DIGITS + rb"(?:[eE][+-]?\d+)?")
# Patterns start with what is rare in numbers, and look behind it for the start of the word: that is 100 times faster.
# Microsoft's `%f` of NaN is 1.#QNAN or 1.#IND, rounded like a number to its decimals: 1.#J, 1.#QO, -1.$.
MICROSOFT = re.compile(
    rb"1\.(?<![^\s,;+-]1\.)(?i:#(?:IND?|INF|IO|I|J|[QS](?:N(?:AN?|B)?|O)?|R|T)|\$)0*(?:[eE]?[+-]\d+)?(?![^\s,;])"
)
C_STANDARD = re.compile(
    rb"[nNiI](?<![^\s,;+-][nNiI])(?:(?<=[nN])(?i:an)|(?<=[iI])(?i:nf(?:inity)?))[qQsS]?(?:\(\w*\))?(?![^\s,;])"
)
INFINITY_SIGN = "\u221e".encode()
FORTRAN = re.compile(rb"[dDqQ](?<=[\d.][dDqQ])(?=[+-]?\d)")
NAN = re.compile(rb"[+-]?nan")
FORTRAN_NOTE = "Exponents written as Fortran does (1.0D+02) were read as powers of ten (1.0E+02)."
GROUPS = r"[+-]?\d{1,3}(?:([ ',._\u2019\u00a0\u202f])\d{3})(?:\1\d{3})*(?:[.,]\d*)?"
REASONS = (  # of words that are no numbers, and what to do; the first that fits counts
    (
        re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?|[+-]?\d+,"),
        "a decimal comma (or a separator of thousands), and numbers need a decimal point: write the file again with the "
        "program's language or locale set to English, or replace the commas by points",
    ),
    (re.compile(GROUPS), "a number with separators of thousands: write it without them"),
    (re.compile(r"(?:[^,]+,){2,}[^,]*"), "numbers with commas between them: put spaces there"),
    (
        re.compile(r"[+-]?(?:\d+\.\d*|\.\d+)[+-]\d+.*"),
        "two numbers without a space between them, or a Fortran exponent that lacks its letter: write more columns",
    ),
    (re.compile(r"\*+"), "what Fortran writes where a number does not fit its columns: write more columns"),
    (re.compile(r"[+-]?0[xX][0-9a-fA-F.]+(?:[pP][+-]?\d+)?"), "a hexadecimal number: write decimal ones"),
    (re.compile(r"[+-]?\d*[.,]?\d+%"), "per cent: divide by 100"),
)
LONGEST = 60  # characters of a word that are looked at


class MendedText(NamedTuple):
    """Text whose numbers a plain parser reads.

    Attributes:
        text: with `nan` for every spelling of NaN and infinity, and E in exponents.
        fortran: how many exponents were written with D or Q.
    """

    text: bytes
    fortran: int


def mend_numbers(text: bytes) -> MendedText:
    """Write NaN, infinity and Fortran's exponents as a plain parser reads them; words end at spaces, commas and semicolons."""
    text, fortran = FORTRAN.subn(b"e", text)
    for pattern in (MICROSOFT, C_STANDARD):
        text = pattern.sub(b"nan", text)
    return MendedText(text.replace(INFINITY_SIGN, b"nan"), fortran)


def parse_numbers(text: bytes) -> np.ndarray | None:
    """Numbers with spaces between, `(number,)` float64; None where something else stands there. Fast: nothing is mended."""
    if not text.strip():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def number_of(word: str) -> float | None:
    """The number that a word is: NaN for NaN and infinity in any spelling; None where it is none."""
    data = word.strip().encode()
    if not NUMBER.fullmatch(data):
        data = mend_numbers(data).text
        if not NUMBER.fullmatch(data) and not NAN.fullmatch(data):
            return None
    return float(data)


def no_number(word: str) -> str:
    """What a word is that is no number, and what to do about it; empty where that is not known.

    Example:
        >>> no_number("1,5")[:15]
        'a decimal comma'
    """
    word = word.strip()[:LONGEST]
    return next((reason for pattern, reason in REASONS if pattern.fullmatch(word)), "")


def reason_of(text: bytes) -> str:
    """Why the first word that is no number is none, as `no_number` says it; empty where all are, or nothing is known of it."""
    words = re.split("[ \\t\\r\\n]+", text.decode("utf-8", "replace").strip())
    return next((no_number(word) for word in words if number_of(word) is None), "")
