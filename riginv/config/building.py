"""Builds objects from configs, from allowed classes only.

A config names a class (`_target_`) and gives its arguments. What is built must be of the requested kind: a rig, a
network. Configs that a user names may name any such class, and within it classes of its own package, of riginv, rigs and
torch. Configs that came with a bundle are untrusted: they may only name classes of riginv and rigs, their arguments are
plain values, and what only users may set (`command_line_only`, such as the path of a program to run) is ignored.
"""

import importlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from riginv.config.aliases import present_argument, present_class
from riginv.config.values import check_value, did_you_mean
from riginv.errors import InputError, in_short

T = TypeVar("T")
OURS = ("riginv", "rigs")
KNOWN = (*OURS, "torch")  # packages of classes within the arguments of a class that a user names, beside its own
DOES_NOT_FIT = (TypeError, ValueError, AttributeError, LookupError, RuntimeError, OverflowError)


@dataclass(frozen=True)
class ClassSpec(Generic[T]):
    """A class that a user's config names, and its arguments: built once, in the command, and handed on as an object.

    `ClassSpec[RigBackend]` as the type of a config's field names the kind of class that is expected there.

    Attributes:
        target_class: the class itself.
        config: as in the config: `_target_` and the arguments, plain values.
        key: its key in the config, for messages: `model.network`.
    """

    target_class: type[T]
    config: Mapping[str, Any]
    key: str = ""

    @classmethod
    def read(cls, config: Any, kind: type[T] | None = None, key: str = "") -> "ClassSpec[T]":
        """The class that a config names; its arguments are compared with the annotations of the class.

        Raises:
            InputError: it does not exist, is of another type, has no such argument, or an argument is not what it must be.
        """
        if not isinstance(config, Mapping):
            raise InputError(f"{key} is {config!r:.80}, expected values with names, the class among them as _target_")
        found = class_of(config.get("_target_"), kind=kind)
        check_arguments(found, config, f"{key}." if key else "", _may_name(found))
        return cls(found, config, key)

    @property
    def target(self) -> str:
        """The name of the class, as in the config."""
        return str(self.config.get("_target_"))

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments as plain values, without `_target_`."""
        return {str(key): value for key, value in self.config.items() if key != "_target_"}

    def build(self, *given: Any, **more: Any) -> T:
        """Build the object.

        Args:
            given: objects that the class, and every class named within its arguments, takes first, such as the rig.
            more: further arguments.
        """
        return build({**self.config, **more}, *given)

    def factory(self) -> "partial[T]":
        """The class with its arguments, to be called with what it acts on, such as an optimiser with parameters."""
        return partial(self.target_class, **_arguments(self.config, (), _may_name(self.target_class)))

    def check(self, **hints: Any) -> None:
        """Check arguments by annotations beyond those of the class, which may be another library's: `lr=PositiveFloat`.

        Raises:
            InputError: an argument does not fit.
        """
        for name, value in self.arguments.items():
            if name in hints:
                check_value(value, hints[name], f"{self.key}.{name}")


def build(config: Any, *given: Any, kind: type | None = None, only: tuple[str, ...] | None = None) -> Any:
    """Build what a plain config describes; classes named within it are built first, each with the same `given` arguments.

    Args:
        config: `_target_` and the arguments of the class.
        given: objects that every class takes first, such as the rig.
        kind: what the class must be, such as a `RigBackend`; None: anything.
        only: packages whose classes may be named, for an untrusted file: no class may be named within; None: any.

    Raises:
        InputError: the class does not exist, is of another type, may not be named, or does not take the arguments.
    """
    if not isinstance(config, Mapping):
        raise InputError(f"a config must name a class as _target_: package.module.Class, found {config!r:.80}")
    target = config.get("_target_")
    target_class = class_of(target, only, kind)
    may_name = None if only else _may_name(target_class)
    arguments = _arguments(config, given, may_name)
    if only is not None:
        for key in getattr(target_class, "command_line_only", ()):
            arguments.pop(key, None)
    try:
        inspect.signature(target_class).bind(*given, **arguments)
    except TypeError as error:
        raise InputError(f"{target}: {error}; its arguments are {inspect.signature(target_class)}") from None
    try:
        return target_class(*given, **arguments)
    except InputError:
        raise
    except DOES_NOT_FIT as error:
        check_arguments(target_class, config, f"{target}: ", may_name)  # the reason, where it is one
        if only is None:
            raise
        raise InputError(
            f"{target} cannot be built from its config: {in_short(error)}; the file is damaged, or not made by riginv"
        ) from error


def _may_name(target_class: type) -> tuple[str, ...]:
    """The packages whose classes may be named within the arguments of a class that a user names."""
    return (*KNOWN, target_class.__module__.partition(".")[0])


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
                outer = config.get("_target_")
                raise InputError(f"{value['_target_']!r:.80} is not allowed here: within {outer} no class may be named")
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
    target = present_class(target)
    package = target.partition(".")[0]
    if only is not None and package not in only:
        raise InputError(
            f"{target} is not allowed here: only classes of {', '.join(only)} are; if you trust it, name the rig yourself"
        )
    module_name, _, name = target.rpartition(".")
    try:
        named = getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError) as error:
        raise InputError(f"cannot find the class {target}: {error}; is its package installed?") from error
    if not inspect.isclass(named):
        raise InputError(f"{target} is not a class")
    if only is not None and named.__module__.partition(".")[0] not in only:
        raise InputError(f"{target} is defined in {named.__module__}, which is not allowed here")
    if kind is not None and not issubclass(named, kind):
        raise InputError(
            f"{target} is not allowed here: it names {named.__name__}, which is no {kind.__module__}.{kind.__name__}"
        )
    return named


def check_arguments(target_class: type, config: Mapping[str, Any], prefix: str, may_name: tuple[str, ...] | None) -> None:
    """Compare the arguments that a config gives a class with the names and annotations of its constructor.

    Args:
        prefix: text before an argument's name in messages.
        may_name: as in `_arguments`; the arguments of classes named within are compared, too.

    Raises:
        InputError: there is no such argument, or it is of another type or out of its range.
    """
    hints, names, target = _hints(target_class), _names(target_class), config.get("_target_")
    for name, value in config.items():
        if name == "_target_":
            continue
        if names is not None and name not in names:
            if present := present_argument(str(target), str(name)):
                raise InputError(f"{prefix}{name} is named {prefix}{present} now")
            raise InputError(f"{prefix}{name}: {target} has no such argument{did_you_mean(str(name), names)}")
        if name in hints:
            _check_argument(value, hints[name], f"{prefix}{name}", may_name)


def _check_argument(value: Any, hint: Any, key: str, may_name: tuple[str, ...] | None) -> None:
    inner = get_args(hint)
    if isinstance(value, Mapping) and "_target_" in value and may_name is not None:
        named = class_of(value["_target_"], may_name, hint if _is_network(hint) else None)
        check_arguments(named, value, f"{key}.", may_name)
    elif isinstance(value, Mapping) and get_origin(hint) is Mapping:
        for name, one in value.items():
            _check_argument(one, inner[1], f"{key}.{name}", may_name)
    elif _is_network(hint) and not isinstance(value, hint):
        raise InputError(f"{key} is {value!r:.80}, expected a class as _target_: a {hint.__module__}.{hint.__name__}")
    else:
        check_value(value, hint, key)


def _is_network(hint: Any) -> bool:
    from torch import nn  # takes seconds, and --help needs none

    return inspect.isclass(hint) and issubclass(hint, nn.Module)


def _names(target_class: type) -> set[str] | None:
    """The arguments that a class takes by name; None where it takes any, or its signature is unknown."""
    names: set[str] = set()
    for ancestor in target_class.__mro__:
        if "__init__" not in vars(ancestor):
            continue
        try:
            parameters = inspect.signature(vars(ancestor)["__init__"]).parameters.values()
        except (TypeError, ValueError):
            return None
        names |= {one.name for one in parameters if one.kind in (one.POSITIONAL_OR_KEYWORD, one.KEYWORD_ONLY)} - {"self"}
        if not any(one.kind is one.VAR_KEYWORD for one in parameters):
            return names
    return None


def _hints(target_class: type) -> dict[str, Any]:
    """The annotations of a constructor's arguments, including those that it passes on to its base classes."""
    hints: dict[str, Any] = {}
    for ancestor in reversed(target_class.__mro__):
        if "__init__" in vars(ancestor):
            try:
                hints |= get_type_hints(vars(ancestor)["__init__"], include_extras=True)
            except (NameError, TypeError, AttributeError):
                continue
    return hints
