"""From configs to objects, without letting a config name what it should not.

A config names a class (`_target_`) and gives its arguments. What is built must be of the kind that is asked for: a rig, a
network. Configs that a user names may name any such class, and within it classes of its own package, of riginv, rigs and
torch. Configs that came with a bundle are untrusted: they may only name classes of riginv and rigs, their arguments are
plain values, and what a class keeps to users (`only_by_hand`, such as the path of a program to run) is ignored.
"""

import importlib
import inspect
from collections.abc import Mapping
from functools import partial
from typing import Any

from riginv.config.arguments import check_arguments
from riginv.errors import InputError, in_short

OURS = ("riginv", "rigs")
KNOWN = (*OURS, "torch")  # what the classes that a user names may be given, beside those of their own package
DOES_NOT_FIT = (TypeError, ValueError, AttributeError, LookupError, RuntimeError, OverflowError)


def build(config: Any, *given: Any, kind: type | None = None, only: tuple[str, ...] | None = None) -> Any:
    """Build what a plain config describes; classes named within it are built first, each with the same `given` arguments.

    Args:
        config: `_target_` and the arguments of the class.
        given: objects that every class takes first, such as the rig.
        kind: what the class must be, such as a `RigBackend`; None: anything.
        only: packages whose classes may be named, for an untrusted file: no class may be named within; None: any.

    Raises:
        InputError: the class does not exist, is of another kind, may not be named, or does not take the arguments.
    """
    if not isinstance(config, Mapping):
        raise InputError(f"a config must name a class as _target_: package.module.Class, found {config!r:.80}")
    found = class_of(config.get("_target_"), only, kind)
    arguments = _arguments(config, given, None if only else (*KNOWN, found.__module__.partition(".")[0]))
    if only is not None:
        arguments = {key: value for key, value in arguments.items() if key not in getattr(found, "only_by_hand", ())}
    target = config["_target_"]
    try:
        inspect.signature(found).bind(*given, **arguments)
    except TypeError as error:
        raise InputError(f"{target}: {error}; its arguments are {inspect.signature(found)}") from None
    try:
        return found(*given, **arguments)
    except InputError:
        raise
    except DOES_NOT_FIT as error:
        check_arguments(found, arguments)  # the reason, where it is one
        if only is None:
            raise
        raise InputError(
            f"{target} cannot be built from what the file says of it: {in_short(error)}; damaged, or not made by riginv"
        ) from error


def factory(config: Any, kind: type | None = None) -> partial:
    """A class with its arguments, still to be called with what it acts on: an optimiser, a schedule.

    Raises:
        InputError: the class does not exist, or is of another kind.
    """
    if not isinstance(config, Mapping):
        raise InputError(f"a config must name a class as _target_: package.module.Class, found {config!r:.80}")
    found = class_of(config.get("_target_"), kind=kind)
    arguments = _arguments(config, (), (*KNOWN, found.__module__.partition(".")[0]))
    try:
        inspect.signature(found).bind_partial(**arguments)
    except TypeError as error:
        raise InputError(f"{config['_target_']}: {error}; its arguments are {inspect.signature(found)}") from None
    check_arguments(found, arguments)
    return partial(found, **arguments)


def _arguments(config: Mapping[str, Any], given: tuple, may_name: tuple[str, ...] | None) -> dict[str, Any]:
    """The arguments in a config.

    Args:
        may_name: packages whose classes may be named within; None: no class may be.
    """

    def value_of(value: Any) -> Any:
        if isinstance(value, Mapping):
            if "_target_" not in value:
                return {key: value_of(inner) for key, inner in value.items()}
            if may_name is None:
                raise InputError(
                    f"{value['_target_']!r:.80} is not allowed here: within {config['_target_']} no class may be named"
                )
            class_of(value["_target_"], may_name)
            return build(value, *given)
        return [value_of(inner) for inner in value] if isinstance(value, list) else value

    return {str(key): value_of(value) for key, value in config.items() if key != "_target_"}


def class_of(target: Any, only: tuple[str, ...] | None = None, kind: type | None = None) -> type:
    """The class that a config names.

    Raises:
        InputError: there is none of that name, it may not be named, or it is not of that kind.
    """
    if not isinstance(target, str) or "." not in target or not all(part.isidentifier() for part in target.split(".")):
        raise InputError(f"a config must name a class as _target_: package.module.Class, found {target!r:.80}")
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
    if kind is not None and not issubclass(found, kind):
        raise InputError(f"{target} is not allowed here: it is no {kind.__module__}.{kind.__name__}")
    return found
