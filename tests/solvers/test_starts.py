"""Where solvers start from, and what good starts and short steps are worth."""

import pytest
import torch

from riginv.geometry.distances import mean_distance
from riginv.rig.batches import generator_at
from riginv.solvers.every_mesh import descend_mean_distance, solve_meshes
from riginv.solvers.levenberg_marquardt import LONGEST_STEP, levenberg_marquardt
from riginv.solvers.objective import Objective
from riginv.solvers.starts import descend, first_start, start_at_random, start_by_derivative
from tests.solvers.test_solvers import Degenerate, in_space, poses


@pytest.fixture(scope="module")
def body_objective(body_in_space):
    return Objective(body_in_space)


def rms_mm(objective, units, coordinates):
    found = objective.rig(objective.to_controls(units))
    return ((found - coordinates).square().sum(dim=1) / objective.vertex_count).sqrt()


def test_poses_of_a_body_are_recovered_from_what_its_features_tell(body_objective):
    body = body_objective.rig.source
    coordinates = body_objective.rig(poses(body, 8))
    start = first_start(body_objective, coordinates)
    assert (start >= 0).all() and (start <= 1).all()
    assert rms_mm(body_objective, start, coordinates).median() < 0.05 * coordinates.norm(dim=1).median() / 13380**0.5
    found = solve_meshes(body_objective, coordinates, starts=1)
    assert rms_mm(body_objective, found.units, coordinates).max() < 5e-3
    assert found.converged.all()


def test_the_metric_of_a_skin_is_sparse_and_says_the_same(body_objective):
    body = body_objective.rig.source
    assert body_objective.metric.is_sparse_csr
    _, jacobian = body.coefficient_jacobian(poses(body, 2))
    squared = jacobian.gram(body_objective.map @ body_objective.map.T)
    torch.testing.assert_close(jacobian.gram(body_objective.metric), squared, atol=1e-4 * float(squared.max()), rtol=0)


def test_other_starts_are_strewn_around_the_first_where_features_gave_it(body_objective, toy):
    first = torch.full((3, body_objective.controls), 0.7)
    other = start_at_random(body_objective, first, 1)
    assert 0.01 < (other - first).std() < 0.03
    around = start_at_random(Objective(toy), torch.full((3, 7), 0.7), 1)
    assert (around - Objective(toy).neutral).abs().max() < 0.2


def test_an_idle_control_starts_at_neutral_and_the_others_do_not(toy):
    objective = Objective(in_space(Degenerate()))
    start = start_by_derivative(objective, objective.rig(poses(objective.rig.source, 4)))
    assert (start[:, 7] == 0).all() and (start[:, :7] != objective.neutral[:7]).all()
    assert (start_at_random(objective, start, 2)[:, 7] == 0).all()


def test_descent_stays_within_limits_and_only_ever_helps(toy):
    target = toy(poses(toy.source, 6)) + 2 * torch.randn(6, toy.space.size, generator=generator_at(0, "descent"))
    target[2] = torch.nan
    start = toy.source.neutral_controls.expand(6, -1)
    found = descend(toy, start, target, 80, 0.03)
    assert (found >= toy.source.lower).all() and (found <= toy.source.upper).all()
    assert torch.equal(found[2], start[2])
    kept = [0, 1, 3, 4, 5]
    before, after = ((toy(one[kept]) - target[kept]).square().sum(dim=1) for one in (start, found))
    assert (after < 0.5 * before).all()
    torch.testing.assert_close(descend(toy, start[kept], target[kept], 80, 0.03), found[kept])
    assert torch.equal(descend(toy, start, target, 0, 0.03), start)
    assert not torch.equal(descend(toy, start, target, 1, 0.03), start)


def test_no_step_is_longer_than_its_reach(toy):
    objective = Objective(toy)
    start = objective.units(toy.source.neutral_controls).expand(5, -1).contiguous()
    once = levenberg_marquardt(objective, toy(torch.ones(5, 7)), start, 1)
    assert 0.5 * LONGEST_STEP < (once.units - start).abs().max() <= LONGEST_STEP + 1e-6


def test_a_start_from_descent_finds_what_newton_steps_miss(face_in_space):
    objective = Objective(face_in_space)
    weights = torch.rand(6, face_in_space.source.primary_count, generator=generator_at(0, "far"))  # all shapes: out of reach
    coordinates = weights @ face_in_space.linear_map[: face_in_space.source.primary_count]
    one, both = (solve_meshes(objective, coordinates, starts, descent_steps=100).cost for starts in (1, 2))
    assert (both <= one).all() and both.mean() < 0.99 * one.mean()


def test_descent_on_the_mean_distance_only_ever_helps(toy):
    rig = in_space(toy.source)
    objective, true = Objective(rig), poses(toy.source, 8)
    coordinates = rig.space.encode(toy.source(true))
    coordinates[:, -1] += 30.0  # out of the rig's reach, mostly at a few vertices
    vertices = rig.space.decode(coordinates)
    squares = solve_meshes(objective, coordinates)
    found = descend_mean_distance(objective, coordinates, squares.units)
    before, after = (mean_distance(toy.source(objective.to_controls(one)), vertices) for one in (squares.units, found))
    assert (after <= before + 1e-4).all() and after.mean() < 0.99 * before.mean()
