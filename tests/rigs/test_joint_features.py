"""Rotations between joints as inputs of inverses of skinned rigs, and the controls that follow from them."""

from pathlib import Path

import pytest
import torch

from riginv.inference.bundle import write_bundle
from riginv.inference.inverse import Inverse, load_inverse
from riginv.networks.features import RigFeatures
from riginv.networks.inverse import StagedInverse
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.tracking.fixed_controls import FixedControlsRig
from rigs.gltf import GltfRig
from tests.support.creatures import Creature, spider, write_creature


@pytest.fixture(scope="module")
def rig(tmp_path_factory) -> GltfRig:
    """A body that turns once and a half, joints that move and scale."""
    return GltfRig(str(write_creature(tmp_path_factory.mktemp("spider") / "spider.glb", spider(), frames=12)), joints=True)


def random_controls(rig: LinearRig, count: int, fraction: float = 1.0) -> torch.Tensor:
    draws = torch.rand(count, len(rig.controls), generator=torch.Generator().manual_seed(4))
    return rig.neutral_controls + fraction * (rig.lower + draws * (rig.upper - rig.lower) - rig.neutral_controls)


def mean_error(rig: LinearRig, found: torch.Tensor, controls: torch.Tensor) -> float:
    """Mean vertex error over the mesh's size."""
    size = float((rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).norm())
    return float((rig(found) - rig(controls)).norm(dim=2).mean()) / size


def in_mesh_space(rig: LinearRig) -> RigInMeshSpace:
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))


def test_features_are_0_at_rest_and_angles_take_the_shorter_way_round(rig):
    rest = rig.features(rig.neutral_coefficients())
    assert torch.allclose(rest[0, 9:], torch.zeros(rest.shape[1] - 9), atol=1e-6) and torch.equal(
        rest[0, :9], torch.eye(3).flatten()
    )
    before, after = (rig.neutral_controls[None].clone() for _ in range(2))
    axis = max(("body.rx", "body.ry", "body.rz"), key=lambda name: float(rig.upper[rig.control_names.index(name)]))
    before[:, rig.control_names.index(axis)], after[:, rig.control_names.index(axis)] = 179.0, 181.0
    change = rig.feature_change(*(rig.features(rig.coefficients(controls)) for controls in (before, after)))
    assert float(change.abs().max()) == pytest.approx(torch.pi / 90, rel=1e-3)


def test_controls_follow_from_the_features_of_a_mesh(rig):
    space, controls = in_mesh_space(rig), random_controls(rig, 16)
    features = RigFeatures.fitted(space)
    guess = features.guess(features(space(controls)))
    assert guess.shape == controls.shape
    assert mean_error(rig, guess, controls) < 2e-5 < 0.1 < mean_error(rig, rig.neutral_controls.expand_as(controls), controls)
    assert (guess >= rig.lower - 0.1).all() and (guess <= rig.upper + 0.1).all()


def test_an_inverse_starts_from_them_and_never_answers_worse(rig):
    space, controls = in_mesh_space(rig), random_controls(rig, 16, 0.9)
    network = StagedInverse(space, hidden=(32,), refinement_steps=1, width=16, gate=8)
    network.calibrate(space(random_controls(rig, 64)))
    with torch.no_grad():
        assert mean_error(rig, network(space(controls)), controls) < 2e-5


def test_fixed_controls_are_left_out(rig):
    free = torch.arange(0, len(rig.controls), 2)
    some = FixedControlsRig(rig, free, rig.neutral_controls)
    features = rig.features(rig.coefficients(random_controls(rig, 2)))
    assert torch.equal(some.guess_from_features(features), rig.guess_from_features(features)[:, free])


def test_for_a_root_without_vertices_stands_the_joint_with_most(tmp_path: Path):
    creature = Creature(turns=200.0, travel=(2.0, 0.3, 1.0), rings=4, around=6)
    root = creature.chain("root", -1, [0, 0, 0], [0, 0.1, 0], 1, 0.1, hidden=True, swing=10)[0]
    trunk = creature.chain("trunk", root, [0, 0.1, 0], [0, 0.3, 0], 1, 0.1, swing=0)[0]
    creature.chain("arm", trunk, [0, 0.4, 0], [0.2, 0, 0], 2, 0.05, swing=60)
    creature.chain("leg", root, [0, 0, 0], [0, -0.3, 0], 2, 0.05, swing=40)
    creature.rings = 4
    rig = GltfRig(str(write_creature(tmp_path / "rootless.glb", creature, frames=12)), joints=True)
    controls = random_controls(rig, 32)
    still = [number for number, name in enumerate(rig.control_names) if name.startswith("trunk.")]
    controls[:, still] = rig.neutral_controls[still]
    space = in_mesh_space(rig)
    features = RigFeatures.fitted(space)
    assert "root.tx" in rig.control_names
    assert mean_error(rig, features.guess(features(space(controls))), controls) < 1e-4


@pytest.mark.parametrize(
    "before", [{"features": False, "preconditioned": False, "distance_steps": 0}, {"preconditioned": False}]
)
def test_a_bundle_from_before_the_features_or_the_preconditioning_goes_on_without(rig, tmp_path, before):
    space, target = in_mesh_space(rig), "riginv.networks.inverse.StagedInverse"
    sizes = {"hidden": (8,), "refinement_steps": 1, "width": 8, "gate": 4}
    network = StagedInverse(space, **sizes, **before)
    network.calibrate(space(random_controls(rig, 64)))
    rig_config = {"_target_": "rigs.gltf.rig.GltfRig", "file": str(rig.file), "joints": True}
    write_bundle(tmp_path / "bundle", "inverse", network, space, {"_target_": target, **sizes}, rig_config, {})
    loaded = load_inverse(tmp_path / "bundle")
    vertices = rig(random_controls(rig, 3))
    with torch.no_grad():
        assert (loaded.network.features is None) == ("features" in before) and loaded.network.preconditioner is None
        assert torch.allclose(loaded(vertices), network(space.space.encode(vertices)), atol=1e-3)


@pytest.mark.slow
def test_an_inverse_of_a_skeleton_is_exported_to_onnx(rig, tmp_path):
    for package in ("onnx", "onnxruntime", "onnxscript"):
        pytest.importorskip(package)
    from riginv.export_onnx import write_onnx

    space = in_mesh_space(rig)
    network = StagedInverse(space, hidden=(16,), refinement_steps=1, width=8, gate=4)
    network.calibrate(space(random_controls(rig, 64)))
    parity = write_onnx(tmp_path / "spider.onnx", Inverse(network).eval().requires_grad_(False))
    assert parity.vertex_mm < 0.05
