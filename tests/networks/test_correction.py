"""A refinement step is zero for a zero residual, and shrinks with it."""

import torch

from riginv.networks.correction import Correction, Descent
from riginv.networks.inverse import StagedInverse


def correction() -> Correction:
    torch.manual_seed(0)
    return Correction(residual=12, controls=7, width=32, gate=16)


def test_a_zero_residual_gives_a_zero_step():
    change = correction()(torch.zeros(3, 12), torch.zeros(3, 7), torch.randn(3, 7))
    assert change.shape == (3, 7) and (change == 0).all()


def test_a_descent_takes_no_step_without_a_gradient():
    torch.manual_seed(0)
    descent, gradient = Descent(controls=7, width=32, gate=16), torch.randn(3, 7)
    residual = gradient[:, :0]
    assert (descent(residual, 0 * gradient, torch.randn(3, 7)) == 0).all()
    assert (descent(residual, gradient, torch.randn(3, 7)) != 0).any()


def test_it_is_linear_in_the_residual_for_equal_gates():
    step, residual, gradient, raw = correction(), torch.randn(5, 12), torch.randn(5, 7), torch.randn(5, 7)
    with torch.no_grad():
        step.gate[0].weight[:, -1] = 0  # the gate's input for the gradient's size
    change = step(residual, gradient, raw)
    torch.testing.assert_close(step(residual / 8, gradient / 8, raw), change / 8, rtol=1e-3, atol=1e-6)
    assert (step(residual, gradient, -raw) - change).abs().max() > 1e-3  # the matrix depends on the controls


def test_corrections_reduce_the_residual_of_the_mlp(toy):
    torch.manual_seed(0)
    network = StagedInverse(toy, stages=1, hidden=[32], refinement_steps=4, width=32, gate=16)
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    coordinates = toy(toy.source.lower + torch.rand(256, 7) * (toy.source.upper - toy.source.lower))
    network.calibrate(coordinates)
    for _ in range(150):
        loss = sum(
            (answer.coordinates - coordinates).square().sum(dim=1).sqrt().mean() for answer in network.estimates(coordinates)
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    errors = [(answer.coordinates - coordinates).norm().item() for answer in network.estimates(coordinates)]
    assert len(errors) == 5 and errors[-1] < 0.3 * errors[0]
