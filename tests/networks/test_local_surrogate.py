"""The surrogate of small parts finds whom each coefficient follows, and learns the toy from that."""

import pytest
import torch

from riginv.networks.dependencies import find_dependencies
from riginv.networks.local import LocalMlps, LocalSurrogate
from riginv.rig.batches import generator_at
from riginv.sampling.controls import SparseControls
from riginv.sampling.meshes import RigPoses
from riginv.training.forward import ForwardModule
from riginv.training.losses import RmsVertexDistanceLoss
from rigs.face.rig import FaceRig
from tests.support.toys import ToyRig


def sets(rows: torch.Tensor) -> list[set[int]]:
    return [set(row[row >= 0].tolist()) for row in rows]


def test_the_toys_wires_are_found():
    rig = ToyRig()
    found = find_dependencies(rig, drivers=3, parents=3)
    wired = [{int(rig.source[driver]) for driver in row if driver >= 0} for row in rig.drivers.tolist()]
    assert sets(found.drivers) == wired
    assert sets(found.parents) == sets(rig.members)


def test_the_faces_wires_are_found():
    rig = FaceRig()
    found = find_dependencies(rig, drivers=4, parents=3)
    wired = [set(rig.driver_control[row[row >= 0]].tolist()) for row in rig.driver_of_shape]
    assert all(own <= seen for own, seen in zip(wired, sets(found.drivers)))
    members = [{shape} for shape in rig.inbetween_shape.tolist()] + sets(rig.combination_members)
    assert all(own <= seen for own, seen in zip(members, sets(found.parents)))


def test_an_output_sees_its_own_inputs_only():
    torch.manual_seed(0)
    local = LocalMlps(3, 2, 8)
    local.index.copy_(torch.tensor([[0, 1], [3, -1], [-1, -1]]))
    inputs = torch.randn(5, 4, requires_grad=True)
    seen = torch.stack([torch.autograd.grad(local(inputs)[:, output].sum(), inputs)[0][0] != 0 for output in range(3)])
    assert seen.tolist() == [[True, True, False, False], [False, False, False, True], [False] * 4]


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_it_learns_the_toy(share, toy):
    torch.manual_seed(0)
    network = LocalSurrogate(toy.source, width=16, corrective_width=8, context=[32])
    network.set_scales(toy.source, toy.source.neutral_controls[None])
    module = ForwardModule(toy, network, RmsVertexDistanceLoss(162), None, None, coefficient_weight=share)
    module.log = lambda *args, **kwargs: None
    poses, optimizer = RigPoses(toy, SparseControls(toy)), torch.optim.Adam(network.parameters(), lr=5e-3)
    for step in range(400):
        optimizer.zero_grad()
        module.training_step(poses.sample(64, generator_at(0, "learning", step)), step).backward()
        optimizer.step()
    batch = poses.sample(64, generator_at(0, "evaluation"))
    with torch.no_grad():
        found = toy.space.encode(module.results(batch))
    assert (found - batch["coordinates"]).norm() < 0.05 * batch["coordinates"].norm()
