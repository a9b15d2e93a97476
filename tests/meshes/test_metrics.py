"""Losses and metrics against plain arithmetic."""

import numpy as np
import pytest
import torch

from riginv.meshes.metrics import roughness
from riginv.meshes.vertex_error import VertexError
from riginv.training.losses import RmsVertexDistanceLoss, SquaredVertexLoss


def test_vertex_errors_do_not_depend_on_how_poses_are_batched():
    draw = np.random.default_rng(0)
    found, expected = draw.normal(size=(10, 7, 3)), draw.normal(size=(10, 7, 3))
    distances = np.linalg.norm(found - expected, axis=2)
    whole = {
        "mean_vertex_error_mm": distances.mean(),
        "max_vertex_error_mm": distances.max(),
        "mean_of_max_vertex_error_mm": distances.max(axis=1).mean(),
    }
    for cuts in ([10], [3, 1, 6], [1] * 10):
        metric, start = VertexError(), 0
        for size in cuts:
            metric.update(torch.from_numpy(found[start : start + size]), torch.from_numpy(expected[start : start + size]))
            start += size
        assert {key: float(value) for key, value in metric.compute().items()} == pytest.approx(whole)


def test_losses_are_those_of_the_vertices():
    coordinates, target = torch.randn(4, 6), torch.randn(4, 6)
    squared = (coordinates - target).square().sum(dim=1)
    torch.testing.assert_close(SquaredVertexLoss(10)(coordinates, target), squared.mean() / 30)
    torch.testing.assert_close(RmsVertexDistanceLoss(10)(coordinates, target), (squared / 10 + 1e-4).sqrt().mean())


def test_the_distance_loss_has_a_gradient_at_0():
    coordinates = torch.zeros(2, 3, requires_grad=True)
    RmsVertexDistanceLoss(5)(coordinates, torch.zeros(2, 3)).backward()
    assert coordinates.grad.isfinite().all()


def test_roughness_is_the_mean_squared_second_difference():
    curves = torch.tensor([[0.0, 1.0], [1.0, 1.0], [0.0, 1.0], [0.0, 4.0]])
    assert roughness(curves) == pytest.approx(((-2.0) ** 2 + 0 + 1.0**2 + 3.0**2) / 4)
    assert roughness(torch.linspace(0, 1, 9)[:, None]) == pytest.approx(0, abs=1e-12)
