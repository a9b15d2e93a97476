"""Whether plain values from a config are what the arguments of a class are annotated as."""

import types
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from riginv.errors import InputError

PLAIN = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


def check_arguments(found: type, arguments: Mapping[str, Any]) -> None:
    """Compare arguments with the annotations of a class; what is not annotated as something plain passes.

    Raises:
        InputError: an argument is of another type; the message names it, and what was expected.
    """
    try:
        hints = get_type_hints(found.__init__)
    except (NameError, TypeError, AttributeError):
        return
    for name, value in arguments.items():
        if name in hints and not fits(value, hints[name]):
            asked = f"{found.__module__}.{found.__qualname__}"
            raise InputError(f"{asked}: {name} is {value!r:.80}, expected {in_words(hints[name])}")


def fits(value: Any, hint: Any) -> bool:
    """Whether a value is what an annotation says."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(fits(value, one) for one in inner)
    if origin is Literal:
        return any(value == one and type(value) is type(one) for one in inner)
    if hint in (None, type(None)):
        return value is None
    if hint is bool:
        return isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is str:
        return isinstance(value, str)
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


def in_words(hint: Any) -> str:
    """What an annotation asks for, for a message."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return " or ".join(in_words(one) for one in inner)
    if origin is Literal:
        return " or ".join(map(repr, inner))
    if hint in (None, type(None)):
        return "null"
    if hint in PLAIN:
        return PLAIN[hint]
    if origin in (dict, Mapping) or hint in (dict, Mapping):
        return "names, each with a value"
    if origin in (list, tuple, Sequence) or hint in (list, tuple, Sequence):
        return f"a list of {in_words(inner[0])}" if inner else "a list"
    return getattr(hint, "__name__", str(hint))
