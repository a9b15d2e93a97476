"""The rigs of a reproduction, built once per process."""

import functools
import json
from dataclasses import replace

from riginv.config.building import ClassSpec, build
from riginv.errors import InputError
from riginv.evaluation.models import surrogate_config
from riginv.evaluation.results import make_true_rig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace

Spec = ClassSpec[RigBackend]


def rig_in_space(spec: Spec) -> RigInMeshSpace:
    """The programmatic rig in its mesh space.

    Raises:
        InputError: it cannot be built, or is no programmatic rig.
    """
    return _rig_in_space(_text(spec))


def trained_rig(bundle: str, like: RigInMeshSpace) -> RigInMeshSpace:
    """The surrogate of a bundle in the mesh space of the rig that it was trained on: they have the same basis."""
    return RigInMeshSpace(build(surrogate_config(bundle), kind=LinearRig), like.space)


def true_rig(spec: Spec | None, rig: LinearRig, workers: int | None = None) -> RigBackend:
    """The rig for evaluation; for None the rig itself.

    Args:
        workers: number of processes, for rigs with worker processes whose config leaves it open.

    Raises:
        InputError: it cannot be built, or has other controls or vertices.
    """
    return rig if spec is None else _true_rig(_text(with_workers(spec, workers)), rig)


def with_workers(spec: Spec, workers: int | None) -> Spec:
    """The class with a number of worker processes, where it has such and leaves the number open."""
    is_open = spec.config.get("workers", 0) is None
    return replace(spec, config={**spec.config, "workers": workers}) if is_open else spec


@functools.lru_cache(maxsize=4)
def _rig_in_space(text: str) -> RigInMeshSpace:
    rig = build(json.loads(text), kind=RigBackend)
    if not isinstance(rig, LinearRig) or not rig.differentiable:
        raise InputError(
            f"rig '{rig.name}' is no programmatic rig: the paper trains through one that ends in a linear map and that "
            f"gradients pass through, such as rig=face; for a black box see riginv.train"
        )
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))


@functools.lru_cache(maxsize=4)
def _true_rig(text: str, rig: LinearRig) -> RigBackend:
    return make_true_rig(ClassSpec.read(json.loads(text), RigBackend, "true_rig"), rig)


def _text(spec: Spec) -> str:
    return json.dumps(dict(spec.config), sort_keys=True)
