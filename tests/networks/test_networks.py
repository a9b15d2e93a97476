"""Networks: they start at neutral, stay within limits, keep their gradients, and answer with or without them."""

import pytest
import torch

from riginv.errors import InputError
from riginv.geometry.kernels.library import kernels, pure_torch
from riginv.networks.control_maps import NeutralStart, RangeTanh
from riginv.networks.inverse import DirectInverse, StagedInverse
from riginv.networks.mlp import mlp
from riginv.networks.surrogate import ControlMLP

NETWORKS = {
    "staged": lambda rig: StagedInverse(rig, stages=3, hidden=[16]),
    "direct": lambda rig: DirectInverse(rig, hidden=[16], control_map="neutral_start"),
    "paper": lambda rig: DirectInverse(rig, hidden=[16]),
}


@pytest.fixture(params=list(NETWORKS))
def network(request, toy):
    torch.manual_seed(0)
    made = NETWORKS[request.param](toy)
    made.calibrate(torch.randn(64, toy.space.size) * 5)
    return made


def test_answers_stay_within_the_limits(network, toy):
    controls = network(torch.randn(50, toy.space.size) * 100)
    assert controls.shape == (50, 7)
    assert (controls >= toy.source.lower).all() and (controls <= toy.source.upper).all()


@pytest.mark.parametrize("name", ["staged", "direct"])
def test_the_neutral_mesh_maps_to_the_neutral_controls_even_when_trained(name, toy):
    torch.manual_seed(1)
    network = NETWORKS[name](toy)
    optimizer = torch.optim.Adam(network.parameters(), lr=0.05)
    for _ in range(20):
        coordinates = torch.randn(16, toy.space.size) * 10
        loss = sum((answer.coordinates - coordinates).square().mean() for answer in network.estimates(coordinates))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    controls = network(torch.zeros(3, toy.space.size))
    torch.testing.assert_close(controls, toy.source.neutral_controls.expand(3, -1), atol=1e-6, rtol=0)
    assert (network(torch.randn(3, toy.space.size) * 10) - toy.source.neutral_controls).abs().max() > 0.05


def test_a_batch_equals_its_rows_and_gradients_do_not_matter(network, toy):
    coordinates = torch.randn(6, toy.space.size) * 5
    together = network(coordinates)
    with torch.no_grad():
        alone = torch.cat([network(row[None]) for row in coordinates])
    torch.testing.assert_close(together.detach(), alone, atol=1e-5, rtol=1e-4)
    assert network.estimates(coordinates)[-1].controls.requires_grad and not alone.requires_grad


def test_neutral_start_keeps_every_gradient_at_neutral_where_a_clamp_would_not(toy):
    control_map = NeutralStart(toy.source)
    raw = torch.tensor([[0.0] * 7, [-0.5] * 7], requires_grad=True)
    controls = control_map(raw)
    controls.sum().backward()
    one_sided = toy.source.lower == 0
    assert (controls[0] == 0).all() and (controls[1, one_sided] == 0).all() and (controls[1, ~one_sided] < 0).all()
    assert (raw.grad > 0.05).all()


def test_controls_that_are_neutral_at_their_upper_limit_go_down():
    class Rig:
        lower, upper, neutral_controls = torch.tensor([-2.0, 0.0]), torch.tensor([0.0, 4.0]), torch.tensor([0.0, 1.0])

    controls = NeutralStart(Rig())(torch.tensor([[0.0, 0.0], [9.0, 9.0], [-9.0, -9.0]]))
    torch.testing.assert_close(controls, torch.tensor([[0.0, 1.0], [0.0, 4.0], [-2.0, 0.0]]), atol=1e-4, rtol=0)


def test_the_papers_map_starts_in_the_middle(toy):
    middle = (toy.source.lower + toy.source.upper) / 2
    torch.testing.assert_close(RangeTanh(toy.source)(torch.zeros(1, 7))[0], middle)


@pytest.mark.parametrize("name", list(NETWORKS))
def test_a_network_saves_its_own_weights_only(name, toy):
    network, other = NETWORKS[name](toy), NETWORKS[name](toy)
    weights = network.own_weights()
    assert weights and not any(key.startswith("rig.") for key in weights)
    other.load_own_weights(weights)
    coordinates = torch.randn(3, toy.space.size)
    torch.testing.assert_close(other(coordinates), network(coordinates))
    with pytest.raises(InputError, match="do not fit"):
        network.load_own_weights({key: value.flatten()[:1] for key, value in weights.items()})


def test_the_surrogates_weights_lie_within_0_and_1(toy):
    weights = ControlMLP(toy.source, hidden=[16])(torch.rand(5, 7) * 100)
    assert weights.shape == (5, 12) and weights.min() >= 0 and weights.max() <= 1


@pytest.mark.parametrize(
    ("hidden", "activation", "says"), [([0], "relu", "widths"), ([4], "sine", "not known"), ([2.5], "relu", "widths")]
)
def test_networks_that_cannot_be_are_refused(hidden, activation, says):
    with pytest.raises(InputError, match=says):
        mlp(3, hidden, 2, activation)


def test_unknown_parts_of_an_inverse_are_refused(toy):
    with pytest.raises(InputError, match="control_map 'clamp'"):
        DirectInverse(toy, control_map="clamp")
    with pytest.raises(InputError, match="stages is 0"):
        StagedInverse(toy, stages=0)


def test_stages_see_the_leading_coordinates_and_distance_steps_all(toy):
    torch.manual_seed(0)
    size = toy.space.size
    network = StagedInverse(toy, hidden=[16], coordinates=size - 2)
    coordinates = toy(toy.source.lower + torch.rand(9, 7) * (toy.source.upper - toy.source.lower)).detach()
    network.calibrate(coordinates)
    assert network.stages[0].network[0].in_features == network.leading.space.size == size - 2
    last = network.estimates(coordinates)[-1]
    assert torch.equal(last.target, coordinates[:, : size - 2])
    torch.testing.assert_close(last.coordinates, toy(last.controls)[:, : size - 2])
    assert network.quasi_newton.distance.frame.shape[0] == size
    changed = coordinates.clone()
    changed[:, -2:] += 5
    with torch.no_grad():
        assert torch.equal(network.estimates(changed)[-1].controls, network.estimates(coordinates)[-1].controls)
        assert (network(changed) - network(coordinates)).abs().max() > 1e-4
    assert StagedInverse(toy, hidden=[16], coordinates=10 * size).leading is toy


def test_small_coordinates_are_left_out(face_in_space):
    sizes = torch.linalg.svdvals(face_in_space.linear_map)
    assert face_in_space.sizable_coordinates(0.0) == face_in_space.sizable_coordinates(1e-7) == len(sizes)
    count = face_in_space.sizable_coordinates(1e-3)
    assert count % 16 == 0 and sizes[count - 17] > 1e-3 * sizes[0] > sizes[count]


@pytest.mark.skipif(kernels() is None, reason="there are no compiled kernels here: no C compiler")
def test_controls_and_their_derivatives_by_a_kernel(face):
    control_map, raw = NeutralStart(face), 2 * torch.randn(6, len(face.controls), generator=torch.Generator().manual_seed(0))
    controls, to_raw = control_map.with_vjp(raw)
    gradient = torch.randn_like(raw)
    with pure_torch():
        expected, expected_to_raw = control_map.with_vjp(raw)
    torch.testing.assert_close(controls, expected, rtol=0, atol=2e-5)
    torch.testing.assert_close(to_raw(gradient), expected_to_raw(gradient), rtol=1e-4, atol=1e-4)
