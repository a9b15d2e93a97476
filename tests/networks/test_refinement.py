"""A refinement step by kernels is that of PyTorch's operations, there and back, and leaves alone what it cannot compute."""

from copy import deepcopy

import pytest
import torch

from riginv.geometry.kernels.library import kernels, pure_torch
from riginv.networks.correction import Correction
from riginv.networks.refinement import fused_step

pytestmark = pytest.mark.skipif(kernels() is None, reason="there are no compiled kernels here: no C compiler")


def step_and_inputs(residual=12, batch=5):
    torch.manual_seed(0)
    step = Correction(residual=residual, controls=7, width=32, gate=16)
    with torch.no_grad():
        step.mix.weight.mul_(20)
    return step, (torch.randn(batch, residual), 0.1 * torch.randn(batch, 7), 3 * torch.randn(batch, 7))


def weights_of(step):
    hidden, _, gates = step.gate
    return [step.features.weight, hidden.weight, hidden.bias, gates.weight, gates.bias, step.mix.weight]


@pytest.mark.parametrize("residual", [12, 0])
@pytest.mark.parametrize("batch", [5, 1])
def test_values_and_gradients_are_those_of_pytorch(residual, batch):
    step, given = step_and_inputs(residual, batch)
    exact, by_step = deepcopy(step).double(), torch.randn(batch, 7)
    found = step(*given)
    expected = exact(*(each.double() for each in given))
    assert "_FusedStep" in str(found.grad_fn) and "_FusedStep" not in str(expected.grad_fn)
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-6)
    gradients = torch.autograd.grad(found, list(step.parameters()), by_step)
    wanted = torch.autograd.grad(expected, list(exact.parameters()), by_step.double())
    for gradient, each in zip(gradients, wanted):
        torch.testing.assert_close(gradient.double(), each, rtol=1e-4, atol=1e-5)


def test_it_is_left_to_pytorch_without_a_graph_of_weights_alone():
    step, (residual, gradient, raw) = step_and_inputs()
    weights = weights_of(step)
    assert fused_step(residual, gradient, raw, weights) is not None
    with torch.no_grad():
        assert fused_step(residual, gradient, raw, weights) is None
    with torch.autocast("cpu", torch.bfloat16):
        assert fused_step(residual, gradient, raw, weights) is None
    with pure_torch():
        assert fused_step(residual, gradient, raw, weights) is None
    assert fused_step(residual, gradient.clone().requires_grad_(), raw, weights) is None
    assert fused_step(*(each.double() for each in (residual, gradient, raw)), [w.double() for w in weights]) is None
