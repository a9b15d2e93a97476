"""The kernels of skeletons against pure PyTorch: the body's coefficients and their vector-Jacobian product."""

import pytest
import torch

from riginv.geometry.kernels.library import kernels, pure_torch
from riginv.rig.interface import LinearRig

pytestmark = pytest.mark.skipif(kernels() is None, reason="there are no compiled kernels here: no C compiler")


def random_controls(body, count, dtype):
    torch.manual_seed(0)
    return (body.lower + torch.rand(count, len(body.controls)) * (body.upper - body.lower)).to(dtype)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-13), (torch.float32, 2e-6)])
def test_the_body_equals_pure_torch_and_its_pull_equals_automatic_differentiation(body, dtype, tolerance):
    controls, gradient = random_controls(body, 9, dtype), torch.randn(9, len(body.basis), dtype=dtype)
    found, vjp = body.coefficients_and_vjp(controls)
    with pure_torch():
        expected, by_autograd = LinearRig.coefficients_and_vjp(body, controls)
        assert torch.equal(body.coefficients(controls), expected)
    assert (found - expected).abs().max() < tolerance * expected.abs().max()
    pulled = by_autograd(gradient)
    assert (vjp(gradient) - pulled).abs().max() < tolerance * pulled.abs().max()
    assert torch.equal(body.coefficients(controls), found)


def test_gradients_that_are_wanted_come_from_automatic_differentiation(body):
    controls = random_controls(body, 3, torch.float32).requires_grad_()
    noise = torch.zeros(3, body.angles.shape[1], requires_grad=True)
    found = body.coefficients_with_joint_noise(controls, noise)
    gradient = torch.randn_like(found)
    of_controls, of_noise = torch.autograd.grad(found, (controls, noise), gradient)
    expected = body.coefficients_and_vjp(controls)[1](gradient)
    torch.testing.assert_close(of_controls, expected, rtol=1e-4, atol=1e-4 * float(expected.abs().max()))
    assert of_noise.abs().max() > 0
