"""Numbers in text files: parsing, repair of unusual spellings, and the reasons why others are refused.

NaN and infinity have many spellings: `nan`, `-nan(ind)`, `1.#IND00` (Microsoft's C library before 2015), `Infinity`. All are
read as NaN, unknown. Fortran writes exponents with D or Q: `1.0D+02`. Both are unambiguous. Decimal commas and separators of
thousands are not: `1,234` may be either.
"""

import re
import warnings
from typing import NamedTuple

import numpy as np

DIGITS = rb"(?:\d+(?:\.\d*)?|\.\d+)"
NUMBER = re.compile(rb"[+-]?" + DIGITS + rb"(?:[eE][+-]?\d+)?")
# Patterns start with characters that are rare in numbers, with a look-behind for the start of the word: 100 times faster.
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
REASONS = (  # why words are not numbers, with remedies; the first match counts
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
LONGEST = 60  # characters of a word that are examined


class MendedText(NamedTuple):
    """Text that a plain parser can read.

    Attributes:
        text: with `nan` for every spelling of NaN and infinity, and E in exponents.
        fortran: the number of exponents with D or Q.
    """

    text: bytes
    fortran: int


def mend_numbers(text: bytes) -> MendedText:
    """Rewrite NaN, infinity and Fortran's exponents for a plain parser; words end at spaces, commas and semicolons."""
    text, fortran = FORTRAN.subn(b"e", text)
    for pattern in (MICROSOFT, C_STANDARD):
        text = pattern.sub(b"nan", text)
    return MendedText(text.replace(INFINITY_SIGN, b"nan"), fortran)


def parse_numbers(text: bytes) -> np.ndarray | None:
    """Numbers separated by white space, `(number,)` float64; None if there is anything else. Fast: nothing is repaired."""
    if not text.strip():
        return np.zeros(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def number_of(word: str) -> float | None:
    """The number of a word: NaN for NaN and infinity in any spelling; None if it is not a number."""
    data = word.strip().encode()
    if not NUMBER.fullmatch(data):
        data = mend_numbers(data).text
        if not NUMBER.fullmatch(data) and not NAN.fullmatch(data):
            return None
    return float(data)


def no_number(word: str) -> str:
    """The reason why a word is not a number, and a remedy; empty where unknown.

    Example:
        >>> no_number("1,5")[:15]
        'a decimal comma'
    """
    word = word.strip()[:LONGEST]
    return next((reason for pattern, reason in REASONS if pattern.fullmatch(word)), "")


def reason_of(text: bytes) -> str:
    """`no_number` of the first word that is not a number; empty where all are."""
    words = re.split("[ \\t\\r\\n]+", text.decode("utf-8", "replace").strip())
    return next((no_number(word) for word in words if number_of(word) is None), "")
