"""Comparison of plain values with type annotations, ranges included, and messages for those that do not fit.

A range is part of the annotation: `steps: PositiveInt` of a dataclass field or of a constructor's argument limits what a config
may hold there.
"""

import difflib
import math
import types
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from riginv.errors import InputError

PLAIN = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


@dataclass(frozen=True)
class Bound:
    """A condition on a value beyond its type: `Annotated[int, Bound("an even number", lambda value: value % 2 == 0)]`.

    Attributes:
        words: what is expected, for a message.
        holds: whether a value of the type is within the bound.
    """

    words: str
    holds: Callable[[Any], bool]


NonNegativeInt = Annotated[int, Bound("a whole number of at least 0", lambda value: value >= 0)]
PositiveInt = Annotated[int, Bound("a whole number of at least 1", lambda value: value >= 1)]
AtLeast2 = Annotated[int, Bound("a whole number of at least 2", lambda value: value >= 2)]
NonNegativeFloat = Annotated[float, Bound("a finite number of at least 0", lambda value: value >= 0)]
PositiveFloat = Annotated[float, Bound("a finite number above 0", lambda value: value > 0)]
Fraction = Annotated[float, Bound("a number from 0 to 1", lambda value: 0 <= value <= 1)]
Widths = Annotated[
    Sequence[int], Bound("a list of whole numbers of at least 1", lambda value: all(width >= 1 for width in value))
]
NonEmpty = Annotated[str, Bound("a path or a URL", lambda value: value != "")]


def check_value(value: Any, hint: Any, key: str) -> None:
    """Raises InputError where a value does not fit an annotation; the message names the key, the value and what is expected."""
    if not fits(value, hint):
        form = f": {key}=[{value}]" if isinstance(value, str) and _is_list(hint) and value.isprintable() else ""
        raise InputError(f"{key} is {value!r:.80}, expected {in_words(hint)}{form}")


def fits(value: Any, hint: Any) -> bool:
    """Whether a plain value fits an annotation; any value does, where the annotation is no plain type.

    Whole numbers are numbers, true and false are none, and NaN and infinite values are none either.
    """
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        bounds = (bound for bound in inner[1:] if isinstance(bound, Bound))
        return fits(value, inner[0]) and all(bound.holds(value) for bound in bounds)
    if origin in (Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is Literal:
        return any(value == one and type(value) is type(one) for one in inner)
    if hint in (None, type(None)):
        return value is None
    if hint in (bool, str):
        return isinstance(value, hint)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if origin is tuple:
        return _fits_tuple(value, inner)
    if origin in (list, Sequence) or hint in (list, tuple, Sequence):
        return _is_sequence(value) and all(fits(one, inner[0]) for one in value if inner)
    if origin in (dict, Mapping) or hint in (dict, Mapping):
        return isinstance(value, Mapping) and all(fits(k, inner[0]) and fits(v, inner[1]) for k, v in value.items() if inner)
    return True


def _fits_tuple(value: Any, inner: tuple) -> bool:
    if not _is_sequence(value):
        return False
    if inner and inner[-1] is Ellipsis:
        return all(fits(one, inner[0]) for one in value)
    return len(value) == len(inner) and all(fits(one, hint) for one, hint in zip(value, inner))


def _is_sequence(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _is_list(hint: Any) -> bool:
    return get_origin(hint) in (list, tuple, Sequence) or hint in (list, tuple, Sequence)


def in_words(hint: Any) -> str:
    """The values that an annotation allows, in words, for a message."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return next((bound.words for bound in inner[1:] if isinstance(bound, Bound)), in_words(inner[0]))
    if origin in (Union, types.UnionType):
        return " or ".join(in_words(one) for one in inner)
    if origin is Literal:
        return " or ".join(map(str, inner))
    if hint in (None, type(None)):
        return "null"
    if hint in PLAIN:
        return PLAIN[hint]
    if origin in (dict, Mapping) or hint in (dict, Mapping) or is_dataclass(origin or hint):
        return "values with names"
    if _is_list(hint):
        return f"a list of {in_words(inner[0])}" if inner and inner[0] is not Any else "a list"
    return getattr(hint, "__name__", str(hint))


def did_you_mean(word: str, words: Collection[str]) -> str:
    """The end of a message about an unknown word: the nearest of the known `words`, if any is near."""
    near = difflib.get_close_matches(word, sorted(words), n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(near)}?" if near else "."
