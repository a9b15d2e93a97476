"""Steps in preconditioned coordinates: the Hessian is the mean over the meshes, and the matrix makes it nearly the identity."""

import pytest
import torch

from riginv.networks.control_maps import CONTROL_MAPS
from riginv.networks.preconditioning import DAMPING, Preconditioner, mean_hessian


@pytest.fixture
def raw(toy) -> torch.Tensor:
    return 0.3 * torch.randn(24, len(toy.source.controls), generator=torch.Generator().manual_seed(2))


def test_the_hessian_is_the_mean_of_those_of_autograd(toy, raw):
    control_map = CONTROL_MAPS["neutral_start"](toy.source)
    expected = torch.zeros(raw.shape[1], raw.shape[1], dtype=torch.float64)
    for row in raw:
        jacobian = torch.autograd.functional.jacobian(lambda one: toy(control_map(one[None]))[0], row).double()
        expected += jacobian.T @ jacobian / len(raw)
    found = mean_hessian(toy, control_map, raw)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4 * float(expected.abs().max()))


def test_the_preconditioned_hessian_is_near_the_identity(toy, raw):
    control_map = CONTROL_MAPS["neutral_start"](toy.source)
    conditioner = Preconditioner(toy, has_features=False)
    conditioner.calibrate(toy, control_map, raw)
    hessian = mean_hessian(toy, control_map, raw)
    matrix = conditioner.matrix.double()
    before, after = hessian, matrix.T @ hessian @ matrix / conditioner.squared_size
    values = torch.linalg.eigvalsh(after)
    assert values.min() > -1e-6 and values.max() < 1.0
    sizes = hessian.diagonal().sqrt()
    least = torch.linalg.eigvalsh(before / sizes[:, None] / sizes).min()
    assert values.min() == pytest.approx(float(least / (least + DAMPING)), rel=0.3)


def test_a_gradient_is_the_negative_of_a_gauss_newton_step_where_nothing_is_damped(toy, raw, monkeypatch):
    monkeypatch.setattr("riginv.networks.preconditioning.DAMPING", 0.0)
    control_map = CONTROL_MAPS["neutral_start"](toy.source)
    conditioner = Preconditioner(toy, has_features=False)
    conditioner.calibrate(toy, control_map, raw)
    hessian, gradient = mean_hessian(toy, control_map, raw), torch.randn(3, raw.shape[1]).double()
    expected = torch.linalg.solve(hessian, gradient.T).T
    found = conditioner.step(conditioner.gradient(gradient.float())).double()
    torch.testing.assert_close(found, expected, rtol=1e-2, atol=1e-3 * float(expected.abs().max()))


def test_controls_without_effect_get_finite_steps(toy, raw):
    conditioner = Preconditioner(toy, has_features=False)
    conditioner.calibrate(toy, CONTROL_MAPS["range_tanh"](toy.source), torch.full_like(raw, 40.0))  # at their limits
    assert torch.isfinite(conditioner.matrix).all()
