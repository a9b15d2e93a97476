"""An inverse with packed weights gives what the network gives, and leaves alone what it cannot compute."""

from copy import deepcopy

import pytest
import torch

from riginv.geometry.kernels.library import kernels, pure_torch
from riginv.inference.inverse import Inverse
from riginv.networks.inverse import StagedInverse
from riginv.networks.packed import PackedInverse
from riginv.runs.huge_pages import in_huge_pages

pytestmark = pytest.mark.skipif(kernels() is None, reason="there are no compiled kernels here: no C compiler")


def random_network(rig, **settings):
    """A network whose refinement steps matter, and mesh coordinates of random controls."""
    torch.manual_seed(0)
    network = StagedInverse(rig, hidden=[48, 32], refinement_steps=6, width=40, gate=24, **settings)
    controls = rig.source.lower + torch.rand(33, len(rig.source.controls)) * (rig.source.upper - rig.source.lower)
    coordinates = rig(controls).detach()
    network.calibrate(coordinates)
    with torch.no_grad():
        network.stages[0].network[-1].weight.mul_(8)
        for correction in network.corrections:
            correction.mix.weight.mul_(5)
    return network.requires_grad_(False).eval(), coordinates


@pytest.mark.parametrize("batch", [1, 2, 33])
@pytest.mark.parametrize("settings", [{}, {"activation": "silu"}, {"preconditioned": False}, {"weighted_steps": 2}], ids=str)
def test_it_equals_the_network(toy, settings, batch):
    network, coordinates = random_network(toy, **settings, distance_steps=0)
    found, expected = PackedInverse.of(network)(coordinates[:batch]), network(coordinates[:batch])
    with pure_torch():
        exact = deepcopy(network).double()(coordinates[:batch].double())
    span = toy.source.upper - toy.source.lower
    assert ((expected - toy.source.neutral_controls).abs() / span).max() > 0.03
    assert ((found - expected).abs() / span).max() < 2e-6
    assert ((found - exact).abs() / span).max() < 4 * ((expected - exact).abs() / span).max() + 1e-6  # no less exact


@pytest.mark.parametrize("batch", [1, 33])
def test_steps_on_the_mean_distance_follow(toy, batch):
    network, coordinates = random_network(toy)
    coordinates = coordinates[:batch] + torch.randn(batch, toy.space.size, generator=torch.Generator().manual_seed(0))
    span = toy.source.upper - toy.source.lower
    found, expected = PackedInverse.of(network)(coordinates), network(coordinates)
    last = network.estimates(coordinates)[-1].controls
    assert ((expected - last).abs() / span).max() > 0.03 and ((found - expected).abs() / span).max() < 1e-3
    assert ((found - expected).abs() / span).mean() < 1e-5


def test_it_sees_the_coordinates_that_the_network_sees(toy):
    network, coordinates = random_network(toy, coordinates=toy.space.size - 2, distance_steps=0)
    span = toy.source.upper - toy.source.lower
    assert ((PackedInverse.of(network)(coordinates) - network(coordinates)).abs() / span).max() < 2e-6


def test_many_meshes_are_shared_by_threads(face_in_space, monkeypatch):
    network, coordinates = random_network(face_in_space)
    inverse, shares = Inverse(network).eval().requires_grad_(False), []
    answer = inverse.answer
    monkeypatch.setattr(inverse, "answer", lambda some: shares.append(len(some)) or answer(some))
    meshes = face_in_space.space.decode(coordinates)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    found = inverse(meshes)
    assert sorted(shares) == [16, 17]
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    torch.testing.assert_close(inverse(meshes), found, rtol=0, atol=1e-3)
    assert shares[2:] == [33]


def test_the_neutral_mesh_maps_to_the_neutral_controls(toy):
    packed = PackedInverse.of(random_network(toy)[0])
    for batch in (1, 5):
        assert torch.equal(packed(torch.zeros(batch, toy.space.size)), toy.source.neutral_controls.expand(batch, -1))


def test_an_inverse_uses_it_where_it_can(toy):
    network, coordinates = random_network(toy, distance_steps=0)
    inverse = Inverse(network).eval().requires_grad_(False)
    assert (
        inverse.packed is not None and inverse.packed(coordinates[:0]) is None and inverse.packed(coordinates.double()) is None
    )
    assert inverse.answer(coordinates[:0]).shape == (0, 7)
    with pure_torch():
        assert inverse.packed(coordinates) is None
        expected = inverse.answer(coordinates)
    torch.testing.assert_close(inverse.answer(coordinates), expected, rtol=0, atol=1e-5)
    assert inverse.answer(torch.full_like(coordinates, torch.nan)).isnan().all()


def test_other_networks_stay_as_they_are(toy):
    assert PackedInverse.of(random_network(toy, stages=2)[0]) is None
    assert PackedInverse.of(random_network(toy, control_map="range_tanh")[0]) is None
    assert PackedInverse.of(deepcopy(random_network(toy)[0]).double()) is None
    assert Inverse(random_network(toy)[0].requires_grad_(True)).packed is None


def test_tensors_in_huge_pages_are_copies():
    given = [torch.arange(7), torch.randn(1000, 900).T, torch.zeros(()), torch.randn(3).double(), torch.empty(0)]
    for copy, tensor in zip(in_huge_pages(given), given):
        assert copy.dtype == tensor.dtype and torch.equal(copy, tensor) and copy.is_contiguous()
        assert copy.data_ptr() % 64 == 0
        copy += 1
        assert copy.numel() == 0 or not torch.equal(copy, tensor)
