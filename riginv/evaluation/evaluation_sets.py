"""Evaluation sets: fixed, the same for every model and training seed."""

import torch

from riginv.geometry.neighbours import evenly
from riginv.rig.batches import PoseBatch, generator_at
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet, PosedRig, WeightedShapes
from riginv.rig.mesh_space import MeshSpace
from riginv.rig.random_controls import sparse_controls
from riginv.sampling.meshes import random_weights

TEST_SEED = 20221206  # the day the paper was presented; training draws under other names


def random_sets(true_rig: RigBackend, count: int, purpose: str = "test") -> list[MeshSet]:
    """The paper's random combinations of blendshapes (where the rig has any), and its sparse random poses of the rig.

    Args:
        count: meshes in each set.
        purpose: sets for different purposes, `test` and `validation`, are disjoint.
    """
    poses = random_poses(true_rig, count, purpose)
    if not (isinstance(true_rig, LinearRig) and true_rig.has_blendshapes):
        return [poses]
    name = "random_combinations"
    weights = random_weights(len(true_rig.basis), count, generator_at(TEST_SEED, purpose, name))
    return [WeightedShapes(name, true_rig.rest_vertices, true_rig.basis, weights), poses]


def random_poses(true_rig: RigBackend, count: int, purpose: str = "test") -> PosedRig:
    """The paper's sparse random poses of the rig, as in `random_sets`."""
    limits = true_rig.lower, true_rig.upper, true_rig.neutral_controls
    controls = sparse_controls(*limits, len(true_rig.controls), count, generator_at(TEST_SEED, purpose, "rig_poses"))
    return PosedRig("rig_poses", true_rig, controls)


def watched(sets: list[MeshSet], space: MeshSpace, count: int) -> dict[str, PoseBatch]:
    """Validation sets, evaluated during training: up to `count` evenly spaced meshes of each set, in mesh coordinates."""
    result = {}
    for mesh_set in sets:
        rows = evenly(count, len(mesh_set)).tolist()
        batch = PoseBatch(coordinates=torch.cat([space.encode(mesh_set.vertices(row, row + 1)) for row in rows]))
        if mesh_set.controls is not None:
            batch["controls"] = mesh_set.controls[rows]
        result[mesh_set.name] = batch
    return result
