"""Which methods of a list can invert a rig: one list serves faces and bodies, and black boxes."""

from collections.abc import Mapping
from typing import Any

from riginv.build import build, class_of
from riginv.errors import InputError
from riginv.mesh_space import RigInMeshSpace
from riginv.methods.base import Method


def suited_methods(configs: Mapping[str, Mapping[str, Any]], rig: RigInMeshSpace) -> tuple[dict[str, Method], dict[str, str]]:
    """The methods that configs name, ready for the rig, and why others are left out, by name.

    Raises:
        InputError: nothing is named, or nothing of it can invert the rig; or a config is wrong.
    """
    if not configs:
        raise InputError("methods names nothing to compare: methods=[NAME,NAME,...]")
    reasons = {name: _method_class(name, config).unsuited(rig.rig) for name, config in configs.items()}
    methods = {name: build(config, rig, kind=Method) for name, config in configs.items() if not reasons[name]}
    left_out = {name: reason for name, reason in reasons.items() if reason}
    if not methods:
        whys = "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        raise InputError(f"none of the methods can invert rig '{rig.rig.name}' ({whys}): choose others with methods=[NAME,...]")
    return methods, left_out


def _method_class(name: str, config: Any) -> type[Method]:
    found = class_of(config.get("_target_")) if isinstance(config, Mapping) else None
    if found is None or not issubclass(found, Method):
        what = f"names {found.__name__}, which is no riginv.methods.base.Method" if found else f"is {config!r}"
        raise InputError(
            f"methods.{name} {what}: a file of methods/ holds a method's class as _target_ under the method's name"
        )
    return found
