"""The kernels of skeletons against pure PyTorch: the body's coefficients with their derivatives, and features of joints."""

import pytest
import roma
import torch

from riginv.geometry.euler import ORDERS
from riginv.geometry.kernels.library import kernels, pure_torch
from riginv.rig.interface import LinearRig
from riginv.rig.joint_features import JointFeatures, JointFreedom

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


def joint_features() -> JointFeatures:
    """Of a tree of joints that rotate about axes in all orders, translate and scale; one has no vertices."""
    torch.manual_seed(1)
    joints = 8
    rest = torch.cat([roma.random_rotmat(joints), 100 * torch.randn(joints, 3, 1)], dim=2).double()
    orders = torch.tensor([ORDERS[number % len(ORDERS)] for number in range(joints)])
    moved, scaled = torch.arange(joints), torch.arange(joints).repeat_interleave(3)
    axes = torch.eye(3).expand(joints, -1, -1).double(), torch.eye(3).repeat(joints, 1).double()
    freedom = JointFreedom((-1, 0, 1, 2, 2, 4, -1, 6), rest, orders, moved, axes[0], scaled, axes[1])
    return JointFeatures(freedom, torch.tensor([1.0, 1, 0, 1, 1, 1, 1, 1]), 100.0)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-11), (torch.float32, 1e-4)])
def test_joint_features_equal_those_of_pure_torch(dtype, tolerance):
    features = joint_features()
    change = roma.rotvec_to_rotmat(torch.randn(50, 8, 3)) * (1 + 0.2 * torch.randn(50, 8, 3, 1)) - torch.eye(3)
    matrices = torch.cat([change, 30 * torch.randn(50, 8, 3, 1)], dim=3).to(dtype)
    matrices[0] = 0  # at rest
    matrices[1, :, :, :3] = -0.99 * torch.eye(3)  # hardly regular
    found = features(matrices)
    with pure_torch():
        expected = features(matrices)
    difference = found - expected
    angles = difference[:, features.angles]
    difference[:, features.angles] = torch.remainder(angles + torch.pi, 2 * torch.pi) - torch.pi
    assert (difference.abs() <= tolerance * (1 + expected.abs())).all()
    torch.testing.assert_close(features(matrices.requires_grad_()), expected)  # with a graph, without kernels


def test_joint_features_in_gimbal_lock_equal_those_of_pure_torch(body):
    controls = body.neutral_controls.double().expand(len(body.controls), -1).clone()
    controls.diagonal().fill_(90)
    coefficients = body.coefficients(controls)
    found = body.features(coefficients)
    with pure_torch():
        torch.testing.assert_close(found, body.features(coefficients), rtol=0, atol=1e-9)
