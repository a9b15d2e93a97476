"""The blendshapes of an animation: what formats that hold a mesh and its shapes are given."""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.animation.animation import Animation
from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend

BATCH_SIZE = 256  # frames at a time
STILL = 1e-6  # of a weight: a correction that never leaves 0 by more is left out
FAINT_MM = 1e-5  # a vertex that a shape moves by less is not in it


class Shapes(NamedTuple):
    """Shapes and how much of each there is.

    Attributes:
        names: of the shapes.
        deltas: `(shape, vertex, 3)`, mm.
        weights: `(frame, shape)`.
    """

    names: list[str]
    deltas: Tensor
    weights: Tensor


def check_drawable(rig: RigBackend, name: str) -> None:
    """Raises InputError for a rig that a format of shapes and joints, called `name`, cannot hold."""
    if not (isinstance(rig, LinearRig) and rig.has_blendshapes) and rig.skeleton() is None:
        raise InputError(
            f"formats: {name} holds blendshapes or joints, and rig '{rig.name}' tells of neither; choose csv, anim or blender"
        )


@torch.no_grad()
def moving_shapes(animation: Animation) -> Shapes:
    """Every shape that a rig drives directly, and of those that correct these the ones that move in this animation."""
    rig = animation.rig
    assert isinstance(rig, LinearRig)
    weights = torch.cat([rig.coefficients(batch) for batch in animation.controls.split(BATCH_SIZE)])
    kept = (weights.abs() > STILL).any(dim=0)
    kept[: rig.primary_count] = True
    names = [name for name, keep in zip(rig.coefficient_names, kept.tolist()) if keep]
    return Shapes(names, rig.basis[kept], weights[:, kept])


def moved_vertices(deltas: Tensor) -> Tensor:
    """The vertices that a shape `(vertex, 3)` moves."""
    return (deltas.abs().amax(dim=1) > FAINT_MM).nonzero()[:, 0]
