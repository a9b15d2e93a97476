"""Weighted errors: their gradient is that of the mean distance, exactly where every vertex is a cluster, else nearly."""

from copy import deepcopy

import pytest
import torch

from riginv.geometry.kernels.library import pure_torch
from riginv.networks.distance_weights import LEAST, DistanceWeights, axis_by_axis
from riginv.rig.batches import generator_at


def errors(space, count=6):
    return torch.randn(count, space.size, generator=generator_at(0, "errors"), dtype=torch.float64)


def expected(space, error):
    """The gradient of the mean distance by the error, each root rounded off at `LEAST` of the mesh's own mean."""
    error = error.clone().requires_grad_()
    squares = space.decode(error).sub(space.rest_vertices).square().sum(dim=2)
    mean = squares.sqrt().mean(dim=1, keepdim=True).detach()
    gradient = torch.autograd.grad((squares + (LEAST * mean).square()).sqrt().sum(), error)[0]
    return mean * gradient


def weights_of(space, *clusters):
    weights = DistanceWeights(space, *clusters).double()
    weights.calibrate(space)
    return weights


def test_the_gradient_is_that_of_the_mean_distance(toy):
    space = deepcopy(toy.space).double()
    weights, error = weights_of(space), errors(space)
    assert (weights.counts == 1).all() and len(weights.counts) == space.vertex_count
    found = weights(error.requires_grad_())
    torch.testing.assert_close(found.error.detach(), expected(space, error.detach()), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(found.scale[:, 0], space.decode(error).sub(space.rest_vertices).norm(dim=2).mean(dim=1).detach())
    derivative = torch.autograd.grad(found.distance.sum(), error)[0]
    torch.testing.assert_close(found.error / (found.scale * space.vertex_count), derivative, rtol=1e-9, atol=1e-9)
    assert bool((found.distance >= found.scale[:, 0]).all()) and bool((found.distance <= 1.02 * found.scale[:, 0]).all())


@pytest.mark.parametrize("clusters", [24, 60])
def test_fewer_clusters_are_nearer_to_it_than_the_error_is(toy, clusters):
    space = deepcopy(toy.space).double()
    weights, error = weights_of(space, clusters), errors(space)
    wanted = expected(space, error)
    assert len(weights.counts) == clusters and int(weights.counts.sum()) == space.vertex_count
    scaled = error * ((wanted * error).sum(dim=1) / error.square().sum(dim=1))[:, None]
    assert (weights(error).error - wanted).norm() < (scaled - wanted).norm()


def test_no_error_stays_none(toy):
    weights = DistanceWeights(toy.space)
    weights.calibrate(toy.space)
    found = weights(torch.zeros(3, toy.space.size))
    assert not found.error.any() and not found.scale.any() and float(found.distance.max()) < 1e-18


@pytest.mark.parametrize("clusters", [24, 162])
def test_kernels_give_the_same(toy, clusters):
    weights = DistanceWeights(toy.space, clusters)
    weights.calibrate(toy.space)
    error = errors(toy.space).float()
    found, axes = weights(error), axis_by_axis(error @ weights.frame)
    by_axis = weights.of_displacements(axes)
    with pure_torch():
        expected, expected_by_axis = deepcopy(weights).double()(error.double()), weights.of_displacements(axes)
    for one, other in zip(found, expected):
        torch.testing.assert_close(one.double(), other, rtol=1e-5, atol=1e-5)
    for one, other in zip(by_axis, expected_by_axis):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)
    assert weights(error.requires_grad_()).distance.requires_grad  # a graph is kept where one is asked for
