"""The rigs of a reproduction, each built once in a process: the programmatic rig, trained ones, and the judge."""

import functools
import json
from collections.abc import Mapping
from typing import Any

from riginv.config.building import ClassSpec, build
from riginv.errors import InputError
from riginv.evaluation.models import surrogate_config
from riginv.evaluation.results import make_true_rig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace


def rig_in_space(config: Mapping[str, Any]) -> RigInMeshSpace:
    """The rig of a config in its mesh space.

    Raises:
        InputError: it cannot be built, or it is no programmatic rig.
    """
    return _rig_in_space(json.dumps(config, sort_keys=True))


def trained_rig(bundle: str, like: RigInMeshSpace) -> RigInMeshSpace:
    """The surrogate of a bundle, in the mesh space of the rig that it stands for: it has the same basis."""
    return RigInMeshSpace(build(surrogate_config(bundle), kind=LinearRig), like.space)


def the_true_rig(config: Mapping[str, Any], rig: LinearRig, workers: int | None = None) -> RigBackend:
    """The rig that judges; the rig itself where the config names none.

    Args:
        workers: processes that it may use, where it runs in such and the config leaves it open.

    Raises:
        InputError: it cannot be built, or has other controls or vertices.
    """
    if not config.get("_target_"):
        return rig
    given = {**config, "workers": workers} if config.get("workers", 0) is None else dict(config)
    return _judge(json.dumps(given, sort_keys=True), rig)


@functools.lru_cache(maxsize=4)
def _rig_in_space(config: str) -> RigInMeshSpace:
    rig = build(json.loads(config), kind=RigBackend)
    if not isinstance(rig, LinearRig) or not rig.differentiable:
        raise InputError(
            f"rig '{rig.name}' is no programmatic rig: the paper trains through one that ends in a linear map and that "
            f"gradients pass through, such as rig=face; for a black box see riginv.train"
        )
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))


@functools.lru_cache(maxsize=4)
def _judge(config: str, rig: LinearRig) -> RigBackend:
    return make_true_rig(ClassSpec.read(json.loads(config), RigBackend, "true_rig"), rig)
