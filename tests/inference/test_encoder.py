"""The quick way to mesh coordinates differs from the exact one by less than a network could see."""

import pytest
import torch

from riginv.inference.inverse import QuickEncoder


def test_rounding_stays_within_its_promise(toy):
    vertices = toy.source(toy.source.lower + torch.rand(20, 7) * (toy.source.upper - toy.source.lower))
    exact, quick = toy.space.encode(vertices), QuickEncoder(toy)(vertices)
    assert quick.dtype == exact.dtype
    assert ((quick - exact).norm(dim=1) <= 0.005 * exact.norm(dim=1)).all()


@pytest.mark.parametrize("rounded", [True, False])
def test_the_rest_mesh_is_zero(toy, rounded):
    assert (QuickEncoder(toy, rounded)(toy.source.rest_vertices[None]) == 0).all()


def test_without_rounding_it_is_exact(toy):
    vertices = toy.source.rest_vertices + torch.randn(3, 162, 3)
    assert torch.equal(QuickEncoder(toy, rounded=False)(vertices), toy.space.encode(vertices))
