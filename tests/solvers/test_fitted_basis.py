"""Solvers on a rig with a fitted basis, whose Jacobian costs much more than a gradient: a DNA head of many joints."""

import pytest
import torch

from riginv.rig.contract import random_controls
from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.fewer_controls import with_fewer_controls
from riginv.solvers.objective import Objective
from riginv.solvers.starts import first_start, start_by_derivative
from tests.rigs.dna.heads import many_joints_fitted


@pytest.fixture(scope="module")
def solved(tmp_path_factory) -> tuple[Objective, torch.Tensor, torch.Tensor]:
    """An objective, and the coordinates and controls of some poses."""
    objective = Objective(many_joints_fitted(tmp_path_factory.mktemp("head") / "many.dna"))
    controls = random_controls(objective.rig.source, 12, 3)
    return objective, objective.rig(controls), controls


def test_the_first_start_is_a_regression_and_nearer_than_one_at_neutral(solved):
    objective, coordinates, _ = solved
    costs = [objective.cost(start(objective, coordinates), coordinates) for start in (first_start, start_by_derivative)]
    assert float(costs[0].mean()) < 0.1 * float(costs[1].mean())


def test_gradient_steps_lower_the_error_between_linearisations(solved):
    objective, coordinates, controls = solved
    assert objective.gradient_steps > 0
    start, costs = start_by_derivative(objective, coordinates), {}
    for objective.gradient_steps in (0, 6):
        costs[objective.gradient_steps] = refine_meshes(objective, coordinates, start, 2).cost
    assert float(costs[6].mean()) < 0.5 * float(costs[0].mean())
    assert bool((costs[6] <= costs[0] * (1 + 1e-5)).all())
    found = refine_meshes(objective, coordinates, first_start(objective, coordinates), 20)
    assert float((objective.to_controls(found.units) - controls).abs().mean()) < 0.02


def test_fewer_controls_keep_the_error(solved):
    objective, coordinates, _ = solved
    found = refine_meshes(objective, coordinates, first_start(objective, coordinates), 10).units
    fewer = with_fewer_controls(objective, coordinates, found)
    root = [(2 * objective.cost(units, coordinates) / objective.squared_mm).sqrt() for units in (found, fewer)]
    assert bool((root[1] <= 1.02 * root[0] + 1.1e-3).all())
