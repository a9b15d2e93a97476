"""Driven-key curves against a bracketing root solver."""

import itertools

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from riginv.geometry.curves import Curve, Key, evaluate_curves, pack_curves


def bezier(t: float, points: list[float]) -> float:
    a, b, c, d = points
    return (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d


def reference(curve: Curve, x: float) -> float:
    """The value of a curve at x as its definition says, by bracketing."""
    x = min(max(x, curve[0].x), curve[-1].x)
    start, end = next((a, b) for a, b in itertools.pairwise(curve) if a.x <= x <= b.x)
    width, reach = end.x - start.x, abs(start.right[0]) + abs(end.left[0])
    scale = min(1.0, width / reach) if reach else 1.0
    xs = [start.x, start.x + scale * start.right[0], end.x + scale * end.left[0], end.x]
    ys = [start.y, start.y + scale * start.right[1], end.y + scale * end.left[1], end.y]

    def miss(t: float) -> float:
        return bezier(t, xs) - x

    t = 0.0 if miss(0.0) >= 0 else 1.0 if miss(1.0) <= 0 else brentq(miss, 0, 1, xtol=1e-15)
    return bezier(t, ys)


def random_curves(count: int, longest_handle: float) -> list[Curve]:
    draw = np.random.default_rng(0)

    def handle(sign: float) -> tuple[float, float]:
        return sign * longest_handle * draw.random(), 0.3 * draw.normal()

    def curve() -> Curve:
        places = np.cumsum(0.05 + draw.random(draw.integers(2, 6)))
        return [Key(x, draw.normal(), handle(-1), handle(1)) for x in places.tolist()]

    return [curve() for _ in range(count)]


# Handles of length 0 make vertical tangents at the keys, where a value is known to the root of the precision only.
@pytest.mark.parametrize(("longest_handle", "tolerance"), [(0.0, 1e-7), (0.3, 1e-11), (2.0, 1e-11)])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_values_equal_those_of_a_bracketing_solver(dtype, tolerance, longest_handle):
    curves = random_curves(60, longest_handle)
    inputs = torch.from_numpy(np.random.default_rng(1).uniform(-0.5, 5, (20, len(curves))))
    found = evaluate_curves(pack_curves(curves).to(dtype), inputs.to(dtype)).double().numpy()
    for column, curve in enumerate(curves):
        expected = [reference(curve, x) for x in inputs[:, column].tolist()]
        np.testing.assert_allclose(found[:, column], expected, atol=tolerance if dtype == torch.float64 else 2e-3)


def test_gradients_equal_finite_differences():
    curves = random_curves(40, 0.4)
    table = pack_curves(curves)
    inputs = torch.from_numpy(np.random.default_rng(2).uniform(0.2, 2, (3, len(curves)))).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: evaluate_curves(table, x), (inputs,))


def test_ends_are_kept_outside_and_still_have_a_gradient_at_the_end():
    table = pack_curves([[Key(0.0, 0.0, right=(0.4, 0.2)), Key(1.0, 1.0, left=(-0.3, -0.3))]])
    inputs = torch.tensor([[-3.0], [0.0], [1.0], [9.0]], dtype=torch.float64, requires_grad=True)
    values = evaluate_curves(table, inputs)
    values.sum().backward()
    assert values.flatten().tolist() == [0, 0, 1, 1]
    assert inputs.grad.flatten().tolist() == pytest.approx([0, 0.5, 1, 0])


def test_a_vertical_tangent_is_solved_too():
    curve = [Key(0.0, 0.0, right=(1.0, 0.0)), Key(1.0, 1.0, left=(-1.0, 0.0))]
    inputs = torch.linspace(0, 1, 101, dtype=torch.float64)[:, None]
    found = evaluate_curves(pack_curves([curve]), inputs)[:, 0]
    expected = [reference(curve, x) for x in inputs[:, 0].tolist()]
    np.testing.assert_allclose(found, expected, atol=1e-8)
    assert (found.diff() >= 0).all()


@pytest.mark.parametrize("keys", [[Key(0, 0)], [Key(0, 0), Key(0, 1)], [Key(1, 0), Key(0, 1)]])
def test_a_curve_without_ascending_keys_is_refused(keys):
    with pytest.raises(ValueError, match="ascending"):
        pack_curves([keys])
