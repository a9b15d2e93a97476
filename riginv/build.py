"""From configs to objects, without letting a config name what it should not.

A config names a class (`_target_`) and gives its arguments. Configs that a user types may name any class; configs that came
with a bundle may only name classes of riginv and rigs, and what the user allows by name; what they say for arguments that a
class keeps to users (`only_by_hand`, such as the path of a program to run) is ignored.
"""

import importlib
import inspect
from collections.abc import Mapping
from functools import partial
from typing import Any

from riginv.errors import InputError

OURS = ("riginv", "rigs")


def build(config: Mapping[str, Any], *given: Any, only: tuple[str, ...] | None = None) -> Any:
    """Build what a plain config describes; classes named within it are built first, each with the same `given` arguments.

    Args:
        config: `_target_` and the arguments of the class.
        given: objects that every class takes first, such as the rig.
        only: packages whose classes may be named; None: any.

    Raises:
        InputError: the class does not exist, may not be named, or does not take the arguments.
    """
    found, arguments = class_of(config.get("_target_"), only), _arguments(config, given, only)
    if only is not None:
        arguments = {key: value for key, value in arguments.items() if key not in getattr(found, "only_by_hand", ())}
    try:
        inspect.signature(found).bind(*given, **arguments)
    except TypeError as error:
        raise InputError(f"{config['_target_']}: {error}; its arguments are {inspect.signature(found)}") from None
    return found(*given, **arguments)


def factory(config: Mapping[str, Any]) -> partial:
    """A class with its arguments, still to be called with what it acts on: an optimiser, a schedule.

    Raises:
        InputError: the class does not exist.
    """
    return partial(class_of(config.get("_target_")), **_arguments(config, (), None))


def _arguments(config: Mapping[str, Any], given: tuple, only: tuple[str, ...] | None) -> dict[str, Any]:
    def value_of(value: Any) -> Any:
        if isinstance(value, Mapping):
            if "_target_" in value:
                return build(value, *given, only=only)
            return {key: value_of(inner) for key, inner in value.items()}
        return [value_of(inner) for inner in value] if isinstance(value, list) else value

    return {key: value_of(value) for key, value in config.items() if key != "_target_"}


def class_of(target: Any, only: tuple[str, ...] | None = None) -> type:
    """The class that a config names.

    Raises:
        InputError: there is none of that name, or it may not be named.
    """
    if not isinstance(target, str) or "." not in target:
        raise InputError(f"a config must name a class as _target_: package.module.Class, found {target!r}")
    package = target.partition(".")[0]
    if only is not None and package not in only:
        raise InputError(
            f"{target} is not allowed here: only classes of {', '.join(only)} are; if you trust it, name the rig yourself"
        )
    module_name, _, name = target.rpartition(".")
    try:
        found = getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"cannot find the class {target}: {error}; is its package installed?") from error
    if not inspect.isclass(found):
        raise InputError(f"{target} is not a class")
    if only is not None and found.__module__.partition(".")[0] not in only:
        raise InputError(f"{target} is defined in {found.__module__}, which is not allowed here")
    return found
