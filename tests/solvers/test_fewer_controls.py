"""The same meshes with fewer active controls."""

import pytest
import torch

from riginv.evaluation.control_accuracy import control_accuracy
from riginv.rig.batches import generator_at
from riginv.rig.control_effects import ControlEffects
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.random_controls import sparse_controls
from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.fewer_controls import MOST_MM, with_fewer_controls
from riginv.solvers.objective import Objective
from riginv.tracking.penalties import ControlPenalties, PenalisedObjective


def sparse_poses(rig, count, most=2):
    return sparse_controls(rig.lower, rig.upper, rig.neutral_controls, most, count, generator_at(0, "sparse"))


def distances_mm(objective, units, coordinates):
    return (2 * (objective.cost(units, coordinates) - objective.prior_cost(units)) / objective.squared_mm).sqrt()


def dense_solution(objective, coordinates, count):
    """Solutions from random controls: those that combine others are mixed with what they combine."""
    start = torch.rand(count, objective.controls, generator=generator_at(1, "start"))
    return refine_meshes(objective, coordinates, start, 40).units


def test_the_controls_of_sparse_poses_are_found(face_in_space):
    rig, objective = face_in_space.source, Objective(face_in_space)
    true, effects = sparse_poses(rig, 40, 10), ControlEffects.of_rig(rig)
    coordinates = face_in_space(true)
    found = dense_solution(objective, coordinates, len(true))
    before, after = (
        control_accuracy(effects, objective.to_controls(units), true, is_clip=False)
        for units in (found, with_fewer_controls(objective, coordinates, found))
    )
    assert before.precision < 0.7
    assert after.precision > 0.9 and after.recall > 0.9 and after.error < 0.5 * before.error


def test_the_distance_hardly_rises_on_meshes_that_the_rig_cannot_make(toy):
    objective = Objective(toy)
    noise = 0.5 * torch.randn(60, toy.space.size, generator=generator_at(0, "noise"))
    coordinates = toy(sparse_poses(toy.source, 60)) + noise
    found = dense_solution(objective, coordinates, 60)
    fewer = with_fewer_controls(objective, coordinates, found)
    before, after = (distances_mm(objective, units, coordinates) for units in (found, fewer))
    assert bool((after <= torch.maximum(1.02 * before, before + MOST_MM) + 1e-6).all())
    assert bool(((fewer >= 0) & (fewer <= 1)).all())


def test_controls_that_are_not_needed_are_exactly_neutral(toy):
    objective, true = Objective(toy), sparse_poses(toy.source, 30)
    found = with_fewer_controls(objective, toy(true), dense_solution(objective, toy(true), 30))
    at_neutral = objective.to_controls(found) == toy.source.neutral_controls
    assert int((~at_neutral).sum()) <= 1.2 * int((true != toy.source.neutral_controls).sum())


def test_meshes_with_nan_and_no_meshes_at_all(toy):
    objective, coordinates = Objective(toy), toy(sparse_poses(toy.source, 6))
    found = dense_solution(objective, coordinates, 6)
    spoiled = coordinates.clone()
    spoiled[2, 0] = torch.nan
    fewer = with_fewer_controls(objective, spoiled, found)
    torch.testing.assert_close(fewer[2], found[2], atol=0, rtol=0)
    others = torch.tensor([0, 1, 3, 4, 5])
    alone = with_fewer_controls(objective, coordinates[others], found[others])
    torch.testing.assert_close(fewer[others], alone, atol=1e-4, rtol=0)
    assert with_fewer_controls(objective, coordinates[:0], found[:0]).shape == (0, objective.controls)


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_penalties_of_the_objective_still_hold(toy, scale):
    true = torch.zeros(1, 7)
    true[0, 6] = 0.6
    pairs = torch.zeros(0, 2, dtype=torch.long)
    penalties = ControlPenalties(torch.tensor([1.0] * 6 + [scale]), pairs, pairs, 0.0, 0.0)
    objective = PenalisedObjective(RigInMeshSpace(toy.source, MeshSpace.from_rig(toy.source)), 1e-6, 0.0, penalties)
    coordinates = objective.rig(true)
    found = with_fewer_controls(objective, coordinates, dense_solution(objective, coordinates, 1))
    assert (float(found[0, 6]) > 0.5) == (scale == 1)
