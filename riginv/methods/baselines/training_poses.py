"""Poses that regressions are fitted to."""

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import MeshSampler

BATCH_SIZE = 500  # poses at a time


def training_poses(rig: RigInMeshSpace, sampler: MeshSampler, count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Mesh coordinates `(pose, coordinate)`, and how far the controls `(pose, control)` are from neutral, in ranges; the rest
    pose is the first of them.

    Raises:
        InputError: there are fewer than three poses, or the sampler draws meshes without their controls.
    """
    if count < 3:
        raise InputError(f"a regression on {count} poses was requested, expected at least 3")
    generator = generator_at(seed, "baseline poses")
    batches = [sampler.sample(min(BATCH_SIZE, count - start), generator) for start in range(0, count, BATCH_SIZE)]
    if "controls" not in batches[0]:
        raise InputError("the sampler of a regression draws meshes without their controls: choose sampler=rig_poses")
    neutral, span = rig.source.neutral_controls, rig.source.upper - rig.source.lower
    controls = torch.cat([neutral[None], *(batch["controls"] for batch in batches)])
    coordinates = torch.cat([rig(neutral[None]).detach(), *(batch["coordinates"] for batch in batches)])
    return coordinates[:count].double(), ((controls - neutral) / span)[:count].double()


def as_controls(rig: RigInMeshSpace, away: Tensor) -> Tensor:
    """Distances from neutral `(mesh, control)`, in ranges, as controls within the limits."""
    own = rig.source.neutral_controls.double() + away * (rig.source.upper - rig.source.lower).double()
    return own.to(rig.source.dtype).clamp(rig.source.lower, rig.source.upper)
