"""Approximations of a rig and the solvers on them, against plain NumPy."""

import itertools

import numpy as np
import pytest
import torch

from riginv.methods.baselines.coordinate_descent import GramDescent
from riginv.methods.baselines.majorisation import Majoriser, _least
from riginv.methods.baselines.measured import pose_coordinates, ramps, tables, with_products
from riginv.methods.baselines.model_objective import ModelObjective
from riginv.methods.baselines.sides import Sides
from riginv.rig.batches import generator_at
from riginv.sampling.controls import SparseControls

MODELS = {
    "linear": lambda rig: ramps(rig, squares=False),
    "quadratic": lambda rig: with_products(rig, ramps(rig, squares=True), [40]),
    "quartic": lambda rig: with_products(rig, ramps(rig, squares=False), [40, 20, 5]),
    "tables": lambda rig: with_products(rig, tables(rig, 5), [40, 20]),
}


@pytest.fixture(scope="module", params=list(MODELS))
def model(request, toy):
    return MODELS[request.param](toy)


def some_weights(model, count: int) -> torch.Tensor:
    return torch.rand(count, len(model.sides), generator=generator_at(0, "weights"), dtype=torch.float64)


def by_hand(model, weights: np.ndarray) -> np.ndarray:
    """The coordinates of one pose, term by term."""
    knots = np.linspace(0, 1, model.table.shape[1])
    total = np.zeros(model.deltas.shape[1])
    for members, delta in zip(model.members.tolist(), model.deltas.numpy()):
        factor = 1.0
        for member in members:
            if member >= 0:
                factor *= np.interp(weights[model.side[member]], knots, model.table[member].numpy())
        total += factor * delta
    return total


def test_sides_lead_from_neutral_to_the_limits(toy):
    sides = Sides(toy.source)
    assert len(sides) == 8 and sorted(map(len, sides.groups)) == [1] * 6 + [2]
    controls = SparseControls(toy).sample(30, generator_at(0, "sides"))
    weights = torch.stack(
        [(controls[:, control] * sign).clamp_min(0) for control, sign in zip(sides.control, sides.reach)], dim=1
    )
    torch.testing.assert_close(sides.controls(weights), controls)
    assert torch.equal(sides.controls(torch.zeros(1, 8))[0], toy.source.neutral_controls)
    assert sides.controls(9 * torch.ones(1, 8)).tolist() == [[1, 1, 1, 1, 1, 0, 1]]  # both sides of one control cancel


def test_a_model_is_the_sum_of_its_terms(model):
    weights = some_weights(model, 6)
    expected = np.stack([by_hand(model, row) for row in weights.numpy()])
    np.testing.assert_allclose(model.coordinates(weights).numpy(), expected, atol=1e-9)
    np.testing.assert_allclose(model.linearised(weights)[0].numpy(), expected, atol=1e-9)


def test_its_derivative_has_the_whole_product_rule(model):
    weights, step = 0.05 + 0.88 * some_weights(model, 3), 1e-6
    _, jacobian = model.linearised(weights)
    for side in range(len(model.sides)):
        move = step * torch.eye(len(model.sides), dtype=torch.float64)[side]
        difference = (model.coordinates(weights + move) - model.coordinates(weights - move)) / (2 * step)
        torch.testing.assert_close(jacobian[:, side], difference, atol=1e-5, rtol=1e-5)


def test_measured_poses_are_met_exactly(toy):
    sides = Sides(toy.source)
    ones = torch.eye(len(sides), dtype=torch.float64)
    pairs = torch.stack([ones[a] + ones[b] for a, b in itertools.combinations(range(len(sides)), 2) if {a, b} != {5, 6}])
    quadratic, quartic, tabled = (MODELS[name](toy) for name in ("quadratic", "quartic", "tables"))
    for poses, models in (
        (ones, (quadratic, quartic, tabled)),
        (0.5 * ones, (quadratic,)),
        (pairs, (quadratic, quartic, tabled)),
        *((knot * ones, (tabled,)) for knot in (0.2, 0.4, 0.6, 0.8)),
    ):
        for found in models:
            apart = found.coordinates(poses) - pose_coordinates(toy, sides, poses)
            assert apart.abs().max() < 1e-2, found  # terms fainter than measured.LEAST_MM are left out


def test_the_objectives_gradient_is_its_derivative(toy):
    objective = ModelObjective(MODELS["tables"](toy), vertex_count=1, prior=0.3, sparsity=2.0)
    weights = 0.02 + 0.93 * some_weights(objective.model, 4)
    target = torch.randn(4, toy.space.size, generator=generator_at(1, "weights"), dtype=torch.float64) * 20
    near, step = objective.linearise(weights, target), 1e-7
    torch.testing.assert_close(near.cost, objective.cost(weights, target))
    for side in range(8):
        move = step * torch.eye(8, dtype=torch.float64)[side]
        derivative = (objective.cost(weights + move, target) - objective.cost(weights - move, target)) / (2 * step)
        torch.testing.assert_close(near.gradient[:, side], derivative, atol=1e-3, rtol=1e-4)


def published_visit(model, weights: np.ndarray, target: np.ndarray, sparsity: float) -> None:
    """Every side once, as the published scripts do it: the whole mesh anew for every single weight."""
    deltas, members = model.deltas.numpy(), model.members.numpy()

    def factors(values: np.ndarray) -> np.ndarray:
        return np.append(values, 1.0)[members].prod(axis=1)

    for side in range(len(weights)):
        used = (members == side).any(axis=1)
        weights[side] = 1.0
        derivative = (factors(weights) * used) @ deltas
        weights[side] = 0.0
        rest = factors(weights) @ deltas - target
        weights[side] = min(max(-(sparsity + derivative @ rest) / (derivative @ derivative), 0.0), 1.0)


def test_coordinate_descent_in_gram_form_is_the_published_one(toy):
    model = MODELS["quartic"](toy)
    descent = GramDescent(model, 0.5, groups=[[side] for side in range(len(model.sides))])
    target = pose_coordinates(toy, model.sides, some_weights(model, 4)) + 1.0
    found = descent(torch.zeros(4, len(model.sides), dtype=torch.float64), target, iterations=3)
    for row in range(4):
        weights = np.zeros(len(model.sides))
        for _ in range(3):
            published_visit(model, weights, target[row].numpy(), 0.5)
        np.testing.assert_allclose(found[row].numpy(), weights, atol=1e-10)


def test_coordinate_descent_never_rises_and_moves_one_side_of_a_control_only(toy):
    model = MODELS["quartic"](toy)
    descent, weights = GramDescent(model, 0.1), torch.zeros(20, len(model.sides), dtype=torch.float64)
    target = pose_coordinates(toy, model.sides, some_weights(model, 20)) + 2.0
    for _ in range(6):
        before, weights = descent.cost(weights, target), descent(weights, target, 1)
        assert (descent.cost(weights, target) <= before + 1e-9).all()
        assert ((weights[:, 5] == 0) | (weights[:, 6] == 0)).all() and weights.min() >= 0 and weights.max() <= 1


def test_the_majoriser_lies_above_the_objective_and_its_steps_never_rise(toy):
    model = MODELS["quadratic"](toy)
    majoriser, weights = Majoriser(model, 0.2), some_weights(model, 20)
    target = pose_coordinates(toy, model.sides, some_weights(model, 20).flip(1)) + 1.0
    found, jacobian = model.linearised(weights)
    residual = found - target
    for number in range(5):
        step = torch.rand(weights.shape, generator=generator_at(number, "step"), dtype=torch.float64) - weights
        first = 2 * (jacobian @ residual[..., None])[..., 0] + 0.2
        second = 2 * (jacobian @ jacobian.transpose(1, 2)).abs().sum(dim=2)
        for slot in (0, 1):
            second.index_add_(1, majoriser.pair[:, slot], (residual @ model.deltas[majoriser.products].T).abs())
        above = (first * step + second * step**2 + majoriser.fourth * step**4).sum(dim=1)
        rise = majoriser.cost(weights + step, target) - majoriser.cost(weights, target)
        assert (rise <= above + 1e-9).all()
    for _ in range(8):
        before, weights = majoriser.cost(weights, target), majoriser(weights, target, 1, 0.0)
        assert (majoriser.cost(weights, target) <= before).all()


def test_the_least_of_a_quartic_is_found_in_closed_form():
    first = torch.tensor([3.0, -2.0, 0.0, 5.0, -7.0, 1.0], dtype=torch.float64)
    second = torch.tensor([1.0, 0.5, 2.0, 4.0, 1e-3, 0.0], dtype=torch.float64)
    fourth = torch.tensor([2.0, 1e3, 1.0, 0.0, 10.0, 0.0], dtype=torch.float64)
    found = _least(first, second, fourth).numpy()
    grid = np.linspace(-3, 3, 600_001)
    for row in range(5):
        values = first[row].item() * grid + second[row].item() * grid**2 + fourth[row].item() * grid**4
        assert abs(found[row] - grid[values.argmin()]) < 1e-4
    assert found[5] == 0
