"""Steps by gradients alone after a network, from a Hessian for either side of each control's neutral."""

import copy
from pathlib import Path

import pytest
import torch

from riginv.geometry.kernels.library import pure_torch
from riginv.inference.bundle import write_bundle
from riginv.inference.inverse import Inverse, load_inverse
from riginv.networks.distance_weights import DistanceWeights
from riginv.networks.inverse import StagedInverse
from riginv.networks.packed import PackedInverse
from riginv.networks.quasi_newton import DAMPING, QuasiNewton
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.contract import random_controls
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from tests.rigs.dna.heads import many_joints_fitted
from tests.support.toys import Plain

SMALL = {"hidden": (8,), "refinement_steps": 1, "width": 8, "gate": 4}


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("head") / "many.dna"


@pytest.fixture(scope="module")
def head(path) -> RigInMeshSpace:
    return many_joints_fitted(path)


@pytest.fixture
def on_toy(toy) -> QuasiNewton:
    method = QuasiNewton(toy, 15)
    method.calibrate(toy)
    return method


def errors(rig: RigInMeshSpace, controls: torch.Tensor, coordinates: torch.Tensor) -> torch.Tensor:
    return (rig(controls) - coordinates).norm(dim=1)


def test_each_mesh_takes_the_hessian_of_its_own_sides(on_toy):
    units = torch.rand(6, len(on_toy.span), generator=torch.Generator().manual_seed(0))
    two_sided, (above, below) = 5, on_toy._sides(units).unbind(dim=1)
    assert torch.equal(below[:, two_sided], (units[:, two_sided] < 0.5).float())
    assert float(below.sum()) == float(below[:, two_sided].sum()) and torch.equal(above + below, torch.ones_like(above))
    gradient = torch.randn(units.shape, generator=torch.Generator().manual_seed(1))
    found = on_toy._solve(on_toy._sides(units), gradient)
    for mesh, sides in enumerate(below.long()):
        rows = sides * len(sides) + torch.arange(len(sides))
        hessian = on_toy.hessian[rows][:, rows].double()
        assert torch.allclose(hessian, hessian.T, rtol=1e-4) and float(torch.linalg.eigvalsh(hessian).min()) > 0
        expected = torch.linalg.solve(hessian + DAMPING * torch.diag(hessian.diagonal()), gradient[mesh].double())
        torch.testing.assert_close(found[mesh].double(), expected, rtol=1e-3, atol=1e-3 * float(expected.abs().max()))


def test_steps_lower_every_error_within_the_limits(toy, on_toy):
    controls, start = (random_controls(toy.source, 32, seed) for seed in (0, 1))
    coordinates = toy(controls)
    before, after = (errors(toy, each, coordinates) for each in (start, on_toy(toy, start, coordinates)))
    assert bool((after <= before * (1 + 1e-5)).all()) and float(after.median()) < 0.05 * float(before.median())
    found = on_toy(toy, start + 3, coordinates)
    assert bool(((found >= toy.source.lower) & (found <= toy.source.upper)).all())
    on_toy.steps = 0
    torch.testing.assert_close(on_toy(toy, start, coordinates), start)


def test_steps_on_the_mean_distance_lower_it_for_every_mesh(toy):
    network = StagedInverse(toy, **SMALL, distance_steps=30)
    controls = random_controls(toy.source, 32, 0)
    noise = torch.randn(32, toy.space.size, generator=torch.Generator().manual_seed(1))
    coordinates = toy(controls) + 0.5 * toy(controls).square().mean().sqrt() * noise  # meshes that the rig cannot make
    network.calibrate(coordinates)
    method, start = network.quasi_newton, network.estimates(coordinates)[-1].controls.detach()

    def mean_distances(controls: torch.Tensor) -> torch.Tensor:
        return (toy.space.decode(toy(controls)) - toy.space.decode(coordinates)).norm(dim=2).mean(dim=1)

    before, after = mean_distances(start), mean_distances(network(coordinates))
    assert len(method.distance.counts) == toy.space.vertex_count  # so that the error is exact
    assert bool((after <= before * (1 + 1e-5)).all()) and float((after / before).mean()) < 0.9
    on_squares = QuasiNewton(toy, 30)
    on_squares.calibrate(toy)
    assert float(after.mean()) < float(mean_distances(on_squares(toy, start, coordinates)).mean())


@pytest.mark.parametrize("steps", [1, 2, 8])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 1e-3), (torch.float64, 1e-8)])
def test_steps_by_a_kernel_equal_those_of_pure_torch(toy, dtype, tolerance, steps):
    rig = copy.deepcopy(toy).to(dtype)
    method = QuasiNewton(rig, steps, DistanceWeights(rig.space, 40)).to(dtype)
    method.calibrate(rig)
    start, controls = (random_controls(rig.source, 24, seed).to(dtype) for seed in (1, 2))
    coordinates = 1.3 * rig(controls)  # the rig cannot make most of these
    coordinates[0] = torch.nan
    found = method(rig, start, coordinates)
    with pure_torch():
        expected = method(rig, start, coordinates)
    assert float((expected - start)[1:].abs().max()) > 0.1
    torch.testing.assert_close(found, expected, rtol=tolerance, atol=tolerance)


def test_steps_on_squares_follow_networks_of_fitted_rigs_alone(toy, head):
    assert isinstance(head.source, BlackBoxRig) and head.source.gradient_steps > 0
    assert (
        StagedInverse(toy, **SMALL).quasi_newton.distance and StagedInverse(toy, **SMALL, distance_steps=0).quasi_newton is None
    )
    network = StagedInverse(head, **SMALL)
    coordinates = head(random_controls(head.source, 64, 4))
    network.calibrate(coordinates)
    controls, last = network(coordinates), network.estimates(coordinates)[-1].controls
    assert float(errors(head, controls, coordinates).mean()) < 0.3 * float(errors(head, last.detach(), coordinates).mean())
    assert not controls.requires_grad and PackedInverse.of(network) is None


@pytest.mark.parametrize("before", [{"features": False, "quasi_newton_steps": 0}, {"quasi_newton_steps": 0}, {}])
def test_a_bundle_keeps_them_and_one_from_before_goes_on_without(head, path, tmp_path, before):
    network = StagedInverse(head, **SMALL, **before)
    network.calibrate(head(random_controls(head.source, 64, 4)))
    config = {"_target_": "riginv.networks.inverse.StagedInverse", **SMALL}
    rig_config = {"_target_": "rigs.dna.DnaRig", "file": str(path)}
    write_bundle(tmp_path / "bundle", "inverse", network, head, config, rig_config, {})
    loaded = load_inverse(tmp_path / "bundle").network
    assert (loaded.quasi_newton is None) == bool(before) and (loaded.features is None) == ("features" in before)
    coordinates = head(random_controls(head.source, 3, 5))
    torch.testing.assert_close(loaded(coordinates), network(coordinates), rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_a_network_with_such_steps_is_exported_to_onnx(tmp_path):
    for package in ("onnx", "onnxruntime", "onnxscript"):
        pytest.importorskip(package)
    from riginv.export_onnx import write_onnx

    rig = BlackBoxRig.sampled(Plain(), samples=150, residual_mm=0.01)  # DNA heads have sparse matrices, which ONNX has not
    space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    network = StagedInverse(space, **SMALL, quasi_newton_steps=3)
    network.calibrate(space(random_controls(rig, 64, 4)))
    parity = write_onnx(tmp_path / "plain.onnx", Inverse(network).eval().requires_grad_(False))
    assert parity.vertex_mm < 0.01
