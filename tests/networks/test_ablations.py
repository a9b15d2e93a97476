"""The networks that test what the paper says of normalisation and of ranges: they differ in that one thing."""

import pytest
import torch
from torch import nn

from riginv.errors import InputError
from riginv.networks.ablations import NormalisedInverse, UnboundedInverse, UnboundedSurrogate
from riginv.networks.inverse import DirectInverse
from riginv.networks.mlp import Linear
from riginv.networks.surrogate import ControlMLP

HIDDEN = (32, 16)


@pytest.mark.parametrize("name, kind", [("batch", nn.BatchNorm1d), ("layer", nn.LayerNorm)])
@pytest.mark.parametrize("control_map", ["neutral_start", "range_tanh"])
def test_layers_of_normalisation_stand_before_each_activation(toy, name, kind, control_map):
    network = NormalisedInverse(toy, name, HIDDEN, control_map=control_map)
    plain = DirectInverse(toy, HIDDEN, control_map=control_map)
    layers = [module for module in network.modules() if isinstance(module, nn.Linear | nn.LeakyReLU | kind)]
    assert [type(layer) for layer in layers] == [Linear, kind, nn.LeakyReLU] * 2 + [Linear]
    assert [layer.num_features if name == "batch" else layer.normalized_shape[0] for layer in layers[1::3]] == list(HIDDEN)
    assert len(network.own_weights()) > len(plain.own_weights())
    if control_map == "neutral_start":
        found = network.eval()(torch.zeros(2, toy.space.size))
        assert torch.equal(found, toy.source.neutral_controls.expand(2, -1))


def test_an_unknown_normalisation_is_refused(toy):
    with pytest.raises(InputError, match="normalisation 'group'.*batch, layer"):
        NormalisedInverse(toy, "group", HIDDEN)


def test_without_tanh_controls_leave_their_range_while_training_and_not_after(toy):
    torch.manual_seed(0)
    network = UnboundedInverse(toy, HIDDEN)
    meshes = 1e4 * torch.randn(16, toy.space.size)
    training = network.estimates(meshes)[0].controls
    assert bool((training > toy.source.upper + 0.5).any()) and bool((training < toy.source.lower - 0.5).any())
    found = network(meshes)
    assert torch.equal(found, training.clamp(toy.source.lower, toy.source.upper))


def test_without_sigmoids_weights_leave_their_range(toy):
    torch.manual_seed(0)
    free, bounded = UnboundedSurrogate(toy.source, HIDDEN), ControlMLP(toy.source, HIDDEN)
    free.load_own_weights(bounded.own_weights())
    controls = 50 * torch.rand(8, len(toy.source.controls))
    assert torch.allclose(torch.sigmoid(free(controls)), bounded(controls), atol=1e-6)
    assert bool((free(controls) < 0).any())
