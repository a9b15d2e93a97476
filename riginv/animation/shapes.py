"""The blendshapes of an animation, for formats that hold a mesh and its shapes."""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.animation.animation import Animation
from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend

BATCH_SIZE = 256  # frames
MIN_WEIGHT = 1e-6  # corrective shapes whose weights never exceed it are omitted
MIN_MM = 1e-5  # vertices that a shape moves by less are omitted
SKELETON = "a skeleton of one root whose joints rotate and move all of the mesh, without scales and morph targets"


class Shapes(NamedTuple):
    """Shapes and their weights.

    Attributes:
        names: of the shapes.
        deltas: `(shape, vertex, 3)`, mm.
        weights: `(frame, shape)`.
    """

    names: list[str]
    deltas: Tensor
    weights: Tensor


def check_drawable(rig: RigBackend, name: str) -> None:
    """Raise InputError for a rig without shapes and joints, which format `name` needs."""
    if not (isinstance(rig, LinearRig) and rig.has_blendshapes) and rig.skeleton() is None:
        raise InputError(
            f"formats: {name} holds blendshapes, or {SKELETON}, and rig '{rig.name}' has neither; choose csv, anim or blender"
        )


@torch.no_grad()
def moving_shapes(animation: Animation) -> Shapes:
    """All primary shapes of a rig, and the corrective shapes that this animation uses."""
    rig = animation.rig
    assert isinstance(rig, LinearRig)
    weights = torch.cat([rig.coefficients(batch) for batch in animation.controls.split(BATCH_SIZE)])
    kept = (weights.abs() > MIN_WEIGHT).any(dim=0)
    kept[: rig.primary_count] = True
    names = [name for name, keep in zip(rig.coefficient_names, kept.tolist()) if keep]
    return Shapes(names, rig.basis[kept], weights[:, kept])


def moved_vertices(deltas: Tensor) -> Tensor:
    """Indices of the vertices that a shape `(vertex, 3)` moves."""
    return (deltas.abs().amax(dim=1) > MIN_MM).nonzero()[:, 0]
