"""Typed configs: a command converts the config that Hydra composed to dataclasses once, and passes these on.

    @dataclass(frozen=True)
    class SampleConfig:
        rig: ClassSpec[RigBackend]          # a class that the config names as _target_, with its arguments
        samples: PositiveInt                # a range is part of the annotation (riginv.config.values)
        dtype: Literal["float32", "float16"]
        mesh_space: MeshSpaceConfig         # another dataclass
        chunk: PositiveInt | None

    settings = to_typed(config, SampleConfig)

OmegaConf's structured configs are not used: they support neither ranges, nor choices, nor third-party classes, and accept 1 for
true. One check against annotations serves both the fields of a config and the arguments of a class.
"""

import dataclasses
import types
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml
from omegaconf import DictConfig

from riginv.config.building import ClassSpec
from riginv.config.messages import CONFIGS
from riginv.config.values import PositiveFloat, PositiveInt, check_value, did_you_mean, fits, in_words
from riginv.errors import InputError
from riginv.runs.run_folder import resolved

T = TypeVar("T")
COMMON_KEYS = ("hydra", "verbose")  # keys of every command, ignored here
REST = {"rest": True}  # metadata of the field that takes the keys that no other field of its dataclass takes


@dataclasses.dataclass(frozen=True)
class MeshSpaceConfig:
    """The mesh space of a rig that does not end in a linear map: principal components of random poses.

    Attributes:
        samples: how many poses.
        residual_mm: the mean vertex distance that may remain between them and the space.
    """

    samples: PositiveInt
    residual_mm: PositiveFloat


def to_typed(config: DictConfig | Mapping[str, Any], kind: type[T]) -> T:
    """The config of a command as an object of its dataclass.

    Args:
        config: as Hydra composed it, or resolved and plain.
        kind: a dataclass. Its fields are annotated with plain types, ranges of `riginv.config.values`, `ClassSpec`, or
            other dataclasses. A field with `metadata=REST` takes all keys that no other field takes.

    Raises:
        InputError: a key is unknown or missing, or a value is of another type, out of its range, or none of its choices. The
            message names the key, what was found and what is expected.
    """
    values = resolved(config) if isinstance(config, DictConfig) else config
    check_value(values.get("verbose", False), bool, "verbose")
    unknown = {str(key) for key in values} - {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    left_out = {*COMMON_KEYS, *(unknown & keys_of_commands() if unknown - set(COMMON_KEYS) else ())}
    return convert({key: value for key, value in values.items() if key not in left_out}, kind, "")


def keys_of_commands() -> set[str]:
    """The first keys of all commands: a user's `local/default.yaml` holds values for several, each takes its own."""
    keys: set[str] = set()
    for path in CONFIGS.glob("*.yaml"):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        groups = (str(next(iter(one))) for one in content.pop("defaults", []) if isinstance(one, dict))
        keys |= {*content, *(group.rpartition("@")[2].rpartition(" ")[2] for group in groups)}
    return keys


def to_plain(value: Any) -> Any:
    """The inverse of `to_typed`: plain values from which it makes an equal object."""
    if isinstance(value, ClassSpec):
        return to_plain(value.config)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        values: dict[str, Any] = {}
        for field in dataclasses.fields(value):
            plain = to_plain(getattr(value, field.name))
            values |= (plain or {}) if field.metadata.get("rest") else {field.name: plain}
        return values
    if isinstance(value, Mapping):
        return {name: to_plain(item) for name, item in value.items()}
    return [to_plain(item) for item in value] if isinstance(value, list | tuple) else value


def convert(value: Any, hint: Any, key: str) -> Any:
    """A plain value converted to the type of an annotation.

    Args:
        key: of the value, for messages.

    Raises:
        InputError: as `to_typed`.
    """
    origin, inner = get_origin(hint), get_args(hint)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return _object(value, hint, key)
    if origin is ClassSpec:
        return ClassSpec.read(value, inner[0], key)
    if origin in (Union, types.UnionType):
        return _one_of(value, hint, key)
    if origin in (dict, Mapping) and isinstance(value, Mapping):
        return {name: convert(item, inner[1], _joined(key, name)) for name, item in value.items()}
    if origin in (list, tuple, Sequence) and isinstance(value, list | tuple) and (origin is not tuple or inner[-1] is Ellipsis):
        items = [convert(item, inner[0], f"{key}[{number}]") for number, item in enumerate(value)]
        return tuple(items) if origin is tuple else items
    if type(value) is int and not fits(value, hint) and fits(str(value), hint):
        value = str(value)  # a name or a path that consists of digits
    check_value(value, hint, key)
    if type(value) is int and (inner[0] if origin is Annotated else hint) is float:
        return float(value)
    return value


def _one_of(value: Any, hint: Any, key: str) -> Any:
    """A value as one of the members of a union."""
    members = get_args(hint)
    nothing = value is None or (isinstance(value, Mapping) and value.get("_target_", "") is None)
    if nothing and type(None) in members:
        return None
    if isinstance(value, Mapping):
        for member in members:
            if get_origin(member) in (ClassSpec, dict, Mapping) or dataclasses.is_dataclass(member):
                return convert(value, member, key)
    for member in members:
        if fits(value, member) and get_origin(member) is not ClassSpec and not dataclasses.is_dataclass(member):
            return convert(value, member, key)
    for member in members:
        if isinstance(value, list) and get_origin(member) in (list, tuple, Sequence):
            return convert(value, member, key)
    if type(value) is int and str in members:
        return str(value)
    raise InputError(f"{key} is {value!r:.80}, expected {in_words(hint)}")


def _object(values: Any, kind: type, key: str) -> Any:
    if not isinstance(values, Mapping):
        raise InputError(f"{key} is {values!r:.80}, expected values with names")
    hints = get_type_hints(kind, include_extras=True)
    fields = {field.name: field for field in dataclasses.fields(kind) if field.init}
    rest = next((name for name, field in fields.items() if field.metadata.get("rest")), None)
    more = {name: value for name, value in values.items() if name not in fields or name == rest}
    found = {rest: convert(more, hints[rest], key)} if rest else {}
    for name in () if rest else more:
        known = {_joined(key, one) for one in fields}
        raise InputError(f"{_joined(key, name)}: there is no such key{did_you_mean(_joined(key, name), known)}")
    for name, field in fields.items():
        if name in values and name != rest:
            found[name] = convert(values[name], hints[name], _joined(key, name))
        elif name != rest and field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise InputError(f"{_joined(key, name)} is missing, expected {in_words(hints[name])}: restore it")
    return kind(**found)


def _joined(key: str, name: Any) -> str:
    return f"{key}.{name}" if key else str(name)
