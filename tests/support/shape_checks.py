"""Checks tensors at run time against shape annotations, and nothing else: plain types are checked by mypy."""

import inspect
from collections.abc import Callable
from typing import Any, get_args

from beartype import beartype
from jaxtyping import AbstractArray


def check_shapes(function: Callable) -> Callable:
    """The typechecker for `jaxtyping.install_import_hook`."""
    hints = {name: hint for name, hint in function.__annotations__.items() if _has_shape(hint)}
    if not hints:
        return function
    function.__annotations__ = hints
    return beartype(function)


def _has_shape(hint: Any) -> bool:
    return any(map(_has_shape, get_args(hint))) or (inspect.isclass(hint) and issubclass(hint, AbstractArray))
