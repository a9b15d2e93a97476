"""Song's surrogate: its reconstruction against NumPy, and its life as a rig."""

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.geometry.neighbours import differential_coordinates, spread_points
from riginv.networks.differential_subspace import DifferentialSubspace, reconstruction
from riginv.rig.batches import generator_at
from riginv.rig.contract import check_rig
from riginv.sampling.controls import SparseControls
from riginv.sampling.meshes import RigPoses
from riginv.training.forward import ForwardModule
from riginv.training.losses import SquaredVertexLoss
from rigs.surrogate import SurrogateRig


def laplacian(faces: np.ndarray, vertices: int) -> np.ndarray:
    neighbours = [set() for _ in range(vertices)]
    for a, b, c in faces.tolist():
        for one, two in ((a, b), (b, c), (c, a)):
            neighbours[one].add(two)
            neighbours[two].add(one)
    matrix = np.zeros((vertices, vertices))
    for vertex, around in enumerate(neighbours):
        if around:
            matrix[vertex, vertex] = 1
            matrix[vertex, list(around)] = -1 / len(around)
    return matrix


def test_differential_coordinates_are_the_graph_laplacian(toy):
    meshes = torch.randn(2, 165, 3, generator=generator_at(0, "meshes"))  # three vertices belong to no face
    expected = np.einsum("vw,mwc->mvc", laplacian(toy.source.faces.numpy(), 165), meshes.numpy())
    np.testing.assert_allclose(differential_coordinates(meshes, toy.source.faces).numpy(), expected, atol=1e-5)


def test_the_reconstruction_is_least_squares_within_the_rigs_span(toy):
    rig, weight = toy.source, 0.3
    anchors = spread_points(rig.rest_vertices, 4)
    assert len(set(anchors.tolist())) == 4
    maps = reconstruction(rig, anchors, weight)
    generator = generator_at(0, "components")
    local, places = (torch.randn(len(parts), generator=generator) for parts in (maps.differential, maps.anchors))
    coefficients = local @ maps.from_differential + places @ maps.from_anchors
    found = (coefficients @ rig.basis.flatten(1)).double().numpy()

    basis = rig.basis.double().numpy()
    apart = np.einsum("vw,kwc->kvc", laplacian(rig.faces.numpy(), 162), basis).reshape(12, -1)
    held = basis[:, anchors.numpy()].reshape(12, -1)
    wanted_apart = np.einsum("k,kvc->vc", local.numpy(), maps.differential.numpy()).ravel()
    wanted_held = np.einsum("k,kac->ac", places.numpy(), maps.anchors.numpy()).ravel()
    system = np.hstack([apart, np.sqrt(weight) * held]).T
    right = np.concatenate([wanted_apart, np.sqrt(weight) * wanted_held])
    expected = np.linalg.lstsq(system, right, rcond=None)[0] @ basis.reshape(12, -1)
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def coordinates(module, controls):
    coefficients, neutral = module.coefficients(controls)
    return (coefficients - neutral) @ module.rig.linear_map


def test_it_learns_the_toy(toy):
    torch.manual_seed(0)
    network = DifferentialSubspace(toy.source, hidden=[64, 64], subspace_hidden=[32], anchors=8)
    module = ForwardModule(toy, network, SquaredVertexLoss(162), None, None)
    poses, optimizer = RigPoses(toy, SparseControls(toy)), torch.optim.Adam(network.parameters(), lr=3e-3)
    for step in range(500):
        batch = poses.sample(64, generator_at(0, "learning", step))
        optimizer.zero_grad()
        module.loss(coordinates(module, batch["controls"]), batch["coordinates"]).backward()
        optimizer.step()
    batch = poses.sample(64, generator_at(0, "evaluation"))
    with torch.no_grad():
        error = (coordinates(module, batch["controls"]) - batch["coordinates"]).norm() / batch["coordinates"].norm()
    assert error < 0.12


def test_a_trained_one_is_a_rig_to_invert_through(run, toy):
    choices = ["model=forward", "model/network=differential_subspace", "model.network.subspace_hidden=[16]"]
    trained = run("train", *choices, "model.network.anchors=6", "model.network.components=9", folder="surrogate")
    assert trained.code == 0, trained.text
    surrogate = SurrogateRig(str(trained.folder))
    check_rig(surrogate)
    assert surrogate.network.from_differential.shape == (9, 12)
    poses = SparseControls(toy).sample(4, generator_at(0, "rig"))
    assert (surrogate(poses) - surrogate(poses.flip(0))).abs().max() > 1e-3
    again = SurrogateRig(str(trained.folder))
    assert torch.equal(again(poses), surrogate(poses))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [({"anchors": 0}, "anchors is 0"), ({"components": 0}, "components is 0"), ({"anchor_weight": 0}, "anchor_weight is 0")],
)
def test_networks_that_cannot_be_are_refused(arguments, says, toy):
    with pytest.raises(InputError, match=says):
        DifferentialSubspace(toy.source, hidden=[4], subspace_hidden=[4], **arguments)
