"""Every baseline: better than neutral by a stated factor, within limits, the same for equal seeds, and hard to upset."""

import functools

import pytest
import torch

from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.evaluation.results import evaluate_controls
from riginv.methods.base import Method, suited_methods
from riginv.methods.baselines.blendshape_weights import BlendshapeWeights
from riginv.methods.baselines.clustered_gaussian_processes import ClusteredGaussianProcesses
from riginv.methods.baselines.coordinate_descent import CoordinateDescent
from riginv.methods.baselines.holden_gaussian_process import HoldenGaussianProcess
from riginv.methods.baselines.holden_network import HoldenNetwork
from riginv.methods.baselines.majorisation import MajorisationMinimisation
from riginv.methods.baselines.quadratic import QuadraticLevenbergMarquardt
from riginv.methods.baselines.tabulated import TabulatedGaussNewton
from riginv.rig.batches import generator_at
from riginv.rig.contract import check_rig
from riginv.rig.interface import Control, LinearRig
from riginv.rig.mesh_sets import PosedRig, WeightedShapes
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.sampling.controls import PlausibleControls, SparseControls
from riginv.sampling.meshes import RandomCombinations, RigPoses
from tests.conftest import ROOT
from tests.support.toys import ToyRig


def sparse_poses(rig):
    return RigPoses(rig, SparseControls(rig))


# A small instance of each, and how many times smaller its error on poses of the toy must be than neutral's.
BASELINES = {
    "holden_network": (lambda rig: HoldenNetwork(rig, sparse_poses(rig), steps=150, hidden=[64]), 5),
    "gaussian_process": (lambda rig: HoldenGaussianProcess(rig, sparse_poses(rig), drawn=1000, poses=300), 15),
    "clustered_processes": (lambda rig: ClusteredGaussianProcesses(rig, sparse_poses(rig), 6, 1000, 150), 7),
    "quadratic": (lambda rig: QuadraticLevenbergMarquardt(rig, pairs=50), 12),
    "coordinate_descent": (lambda rig: CoordinateDescent(rig, 50, 20, 5, sparsity=1e-4), 7),
    "majorisation": (lambda rig: MajorisationMinimisation(rig, pairs=50, sparsity=1e-4), 12),
    "tabulated": (lambda rig: TabulatedGaussNewton(rig, pairs=50, triples=20), 100),
    "blendshape_nnls": (lambda rig: BlendshapeWeights(rig, ridge=1e-3), 8),
    "blendshape_ridge": (lambda rig: BlendshapeWeights(rig, ridge=1e-3, bounded=False), 8),
}
every_baseline = pytest.mark.parametrize("name", list(BASELINES))


class Dull(LinearRig):
    """The toy with a control that does nothing, one that does what another does, and a basis without full rank."""

    def __init__(self) -> None:
        toy = ToyRig()
        controls = [*toy.controls, Control("nothing", lower=-2.0, upper=3.0, neutral=1.0, unit="mm"), Control("twin")]
        basis = torch.cat([toy.basis[:8], toy.basis[:1], toy.basis[8:]])
        super().__init__("dull", controls, toy.rest_vertices, toy.faces, basis, primary_count=9)
        self.toy = toy

    def coefficients(self, controls):
        found = self.toy.coefficients(controls[:, :7])
        return torch.cat([found[:, :8], controls[:, 8:], found[:, 8:]], dim=1)


@pytest.fixture(scope="module")
def dull():
    rig = Dull()
    return RigInMeshSpace(rig, MeshSpace.from_rig(rig))


def poses_of(rig, count: int, name: str = "baseline test") -> PosedRig:
    return PosedRig("poses", rig.source, SparseControls(rig).sample(count, generator_at(0, name)))


def freshly_prepared(name: str, rig, seed: int = 0):
    method = BASELINES[name][0](rig)
    method.prepare(seed)
    return method


@functools.cache
def prepared(name: str, rig, seed: int = 0):
    return freshly_prepared(name, rig, seed)


def share_left(controls, rig, poses) -> float:
    metrics = evaluate_controls(rig.source, poses, controls).metrics
    return metrics["poses/mean_vertex_error_mm"] / metrics["poses/neutral_mean_vertex_error_mm"]


@every_baseline
def test_it_beats_neutral_within_the_limits_and_repeats_itself(name, toy):
    poses = poses_of(toy, 60)
    method = prepared(name, toy)
    controls = method.invert(poses)
    assert controls.shape == (60, 7) and controls.dtype == toy.source.dtype
    assert (controls >= toy.source.lower).all() and (controls <= toy.source.upper).all()
    assert share_left(controls, toy, poses) < 1 / BASELINES[name][1]
    assert torch.equal(freshly_prepared(name, toy).invert(poses), controls)
    assert method.source and len(method.source.split()) > 20


@every_baseline
def test_a_rig_without_full_rank_and_a_control_that_does_nothing_are_survived(name, dull):
    check_rig(dull.source)
    poses = poses_of(dull, 40)
    controls = prepared(name, dull).invert(poses)
    assert torch.isfinite(controls).all()
    assert (controls >= dull.source.lower).all() and (controls <= dull.source.upper).all()
    assert share_left(controls, dull, poses) < 0.5
    if name not in ("holden_network", "gaussian_process"):  # which answer with a mean of what they have seen
        torch.testing.assert_close(controls[:, 7], torch.ones(40), atol=1e-3, rtol=0)


@every_baseline
def test_both_ways_out_of_neutral_are_found(name, toy):
    controls = torch.zeros(6, 7)
    controls[:, 5] = torch.tensor([-1.0, -0.7, -0.4, 0.4, 0.7, 1.0])
    found = prepared(name, toy).invert(PosedRig("poses", toy.source, controls))
    assert torch.equal(found[:, 5].sign(), controls[:, 5].sign())
    assert (found[:, 5] - controls[:, 5]).abs().max() < 0.6


@every_baseline
def test_clips_of_none_and_of_one_frame_and_meshes_out_of_reach(name, toy):
    method = prepared(name, toy)
    rest, deltas = toy.source.rest_vertices, toy.source.basis
    for frames in (0, 1):
        clip = WeightedShapes("clip", rest, deltas, torch.full((frames, 12), 0.3), fps=30.0)
        assert method.invert(clip).shape == (frames, 7)
    wild = WeightedShapes("wild", rest, deltas, torch.tensor([[500.0] * 12, [-500.0] * 12, [0.0] * 12]))
    controls = method.invert(wild)
    assert torch.isfinite(controls).all() and (controls >= toy.source.lower).all() and (controls <= toy.source.upper).all()


@every_baseline
def test_a_frame_of_nan_spoils_no_other(name, toy):
    method, weights = prepared(name, toy), torch.rand(5, 12, generator=generator_at(0, "nan"))
    broken = weights.clone()
    broken[2] = torch.nan
    whole, found = (
        method.invert(WeightedShapes("clip", toy.source.rest_vertices, toy.source.basis, rows, 30.0))
        for rows in (weights, broken)
    )
    assert torch.isfinite(found).all()
    others = [0, 1, 3, 4]
    torch.testing.assert_close(found[others], whole[others], atol=2e-2, rtol=0)


def test_other_seeds_give_other_regressions(toy):
    poses = poses_of(toy, 8)
    for name in ("holden_network", "gaussian_process", "clustered_processes"):
        assert not torch.equal(prepared(name, toy, 0).invert(poses), prepared(name, toy, 1).invert(poses))


def test_a_network_of_a_bundle_is_used_as_it_is(run, toy, tmp_path):
    trained = run("train", "model=holden", "model.network.hidden=[16]")
    assert trained.code == 0, trained.text
    method = HoldenNetwork(toy, sparse_poses(toy), bundle=str(trained.folder))
    method.prepare(0)
    poses = poses_of(toy, 5)
    assert torch.equal(method.invert(poses), method.loaded.inverse(poses.vertices(0, 5)))


def test_what_cannot_be_is_refused(toy):
    class Bones(Dull):
        def __init__(self):
            super().__init__()
            self.primary_count = 0

    bones = Bones()
    config = {"_target_": "riginv.methods.baselines.blendshape_weights.BlendshapeWeights"}
    with pytest.raises(InputError, match="rig 'dull' .nnls: it has no blendshapes"):
        suited_methods({"nnls": ClassSpec.read(config, Method)}, RigInMeshSpace(bones, MeshSpace.from_rig(bones)))
    with pytest.raises(InputError, match="ridge is 0"):
        BlendshapeWeights(toy, ridge=0)
    with pytest.raises(InputError, match="steps is 0"):
        HoldenNetwork(toy, sparse_poses(toy), steps=0)
    with pytest.raises(InputError, match="at least 3"):
        HoldenGaussianProcess(toy, sparse_poses(toy), drawn=2).prepare(0)
    with pytest.raises(InputError, match="without their controls"):
        HoldenGaussianProcess(toy, RandomCombinations(toy), drawn=10).prepare(0)


def test_every_baseline_is_a_config(run):
    small = {
        "holden_network": ["steps=5", "hidden=[8]"],
        "gaussian_process": ["drawn=50", "poses=20"],
        "clustered_processes": ["drawn=50", "poses=20", "clusters=3"],
    }
    changes = [f"methods.{name}.{change}" for name, values in small.items() for change in values]
    outcome = run("compare", "rig=toy", f"methods=[{','.join(BASELINES)}]", "poses=4", *changes, *toy_configs())
    assert outcome.code == 0, outcome.text
    rows = (outcome.folder / "compare.csv").read_text().splitlines()
    assert {row.partition(",")[0] for row in rows[1:]} == set(BASELINES)


def toy_configs() -> list[str]:
    return [f"--config-dir={ROOT / 'tests/conf'}"]


def test_plausible_poses_are_fitted_too(toy):
    method = HoldenGaussianProcess(toy, RigPoses(toy, PlausibleControls(toy, max_active=7)), drawn=400, poses=100)
    method.prepare(0)
    assert share_left(method.invert(poses_of(toy, 30)), toy, poses_of(toy, 30)) < 0.2
