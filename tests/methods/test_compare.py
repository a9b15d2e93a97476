"""python -m riginv.compare: its table, its files, and how it goes on."""

import csv

import pytest
import torch

from riginv.errors import InputError
from riginv.evaluation.optimum import find_optima
from riginv.evaluation.results import evaluate_controls
from riginv.inference.inverse import load_inverse
from riginv.methods.base import Method
from riginv.methods.baselines.holden_network import HoldenNetwork
from riginv.methods.direct import Neutral
from riginv.methods.evaluation import Clocked, evaluated_row
from riginv.methods.network import Network
from riginv.methods.solvers import Clip, LevenbergMarquardt, Refined
from riginv.rig.mesh_sets import PosedRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from tests.config.test_bad_input import refused
from tests.conftest import ROOT
from tests.rigs.dna.files import written
from tests.rigs.dna.heads import many_joints
from tests.solvers.test_solvers import poses
from tests.support.clips import performance, write_npz

TOY = ["rig=toy", f"--config-dir={ROOT / 'tests/conf'}", "poses=12"]
COLUMNS = (
    "method,set,mean_vertex_error_mm,max_vertex_error_mm,roughness,nonzero_controls,ms_per_frame,training_seconds,optimum_ratio,"
    "control_precision,control_recall,control_error_weighted"
)


def rows_of(outcome):
    text = (outcome.folder / "compare.csv").read_text()
    assert text.splitlines()[0] == COLUMNS
    return {(row["method"], row["set"]): row for row in csv.DictReader(text.splitlines())}


def test_methods_stand_side_by_side(run):
    outcome = run("compare", *TOY, "poses=200", "methods=[neutral,levenberg_marquardt,clip]", "methods.clip.smoothness=20")
    assert outcome.code == 0, outcome.text
    rows = rows_of(outcome)
    assert [method for method, _ in rows][::3] == ["neutral", "levenberg_marquardt", "clip"]
    best, smooth = (rows[name, "simulated_performance"] for name in ("levenberg_marquardt", "clip"))
    assert float(best["mean_vertex_error_mm"]) < 0.5 * float(rows["neutral", "simulated_performance"]["mean_vertex_error_mm"])
    assert 1 <= float(best["optimum_ratio"]) < 1.25  # least squares: the optimum is that of the mean distance
    assert float(smooth["roughness"]) < float(best["roughness"])
    assert float(rows["neutral", "rig_poses"]["nonzero_controls"]) == 0
    assert rows["neutral", "rig_poses"]["roughness"] == ""
    assert float(rows["neutral", "rig_poses"]["control_recall"]) == 0
    assert rows["neutral", "rig_poses"]["control_precision"] == rows["neutral", "random_combinations"]["control_recall"] == ""
    assert float(rows["levenberg_marquardt", "rig_poses"]["control_recall"]) > 0.8
    assert "times" in outcome.text and "levenberg" in outcome.text
    assert "**clip**: riginv" in (outcome.folder / "compare.md").read_text()
    assert (outcome.folder / "compare.png").read_bytes()[:4] == b"\x89PNG"


def test_a_comparison_goes_on_method_by_method(run):
    first = run("compare", *TOY, "methods=[neutral]")
    assert "a simulated performance of 1.8 s" in first.text  # as few frames as there are poses
    kept = first.folder / "methods/neutral.json"
    kept.write_text(kept.read_text().replace('"nonzero_controls": 0.0', '"nonzero_controls": 7.0'))  # to be known again
    refused(run("compare", *TOY, "methods=[neutral]"), "resume=true")
    refused(run("compare", *TOY, "methods=[neutral]", "seed=3", "resume=true"), "seed was 0, now 3")
    again = run("compare", *TOY, "methods=[neutral,levenberg_marquardt]", "resume=true")
    assert again.code == 0, again.text
    rows = rows_of(again)
    assert rows["neutral", "rig_poses"]["nonzero_controls"] == "7.0"
    assert ("levenberg_marquardt", "rig_poses") in rows
    other = run("compare", *TOY, "methods=[levenberg_marquardt]", "methods.levenberg_marquardt.steps=1", "resume=true")
    assert rows_of(other)["neutral", "rig_poses"]["nonzero_controls"] == "7.0"  # not named this time, and still there
    worse, better = rows_of(other)["levenberg_marquardt", "rig_poses"], rows["levenberg_marquardt", "rig_poses"]
    assert float(worse["mean_vertex_error_mm"]) > float(better["mean_vertex_error_mm"])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["methods=[neutral,levenberg_marquart]"], "did you mean levenberg_marquardt"),
        (["methods=[]"], "methods names nothing to compare"),
        (["methods=[network]"], "methods.network.bundle must be given"),
        (["methods=[network]", "methods.network.bundle=nowhere"], "nowhere: no bundle there"),
        (["methods=[clip]", "methods.clip.smoothness=-1"], "smoothness is -1"),
        (["methods=[levenberg_marquardt]", "methods.levenberg_marquardt.starts=0"], "starts is 0"),
        (["poses=0"], "poses is 0"),
        (["methods=[clip]", "methods.clip.key_starts=0"], "methods.clip.key_starts is 0"),
        (["methods=[quadratic]", "methods.quadratic.pairs=1.5"], "methods.quadratic.pairs is 1.5"),
        (["methods=[tabulated]", "methods.tabulated.knots=0"], "methods.tabulated.knots is 0"),
        (["methods=[network]", "methods.network.bundle=null"], "bundle is None"),
        (["methods=[neutral]", "methods.neutral._target_=riginv.errors.InputError"], "InputError, which is no riginv.methods"),
        (["methods=[neutral]", "+methods.odd=3"], "methods.odd is 3"),
    ],
)
def test_mistakes_are_named(run, arguments, says):
    outcome = run("compare", *TOY, *arguments)
    refused(outcome, says)
    assert not outcome.folder.exists()


def test_a_sweep_of_comparisons_ends_in_one_table(run, tmp_path):
    outcome = run("compare", "-m", *TOY, "methods=[neutral]", "seed=0,1", f"hydra.sweep.dir={tmp_path / 'sweep'}")
    assert outcome.code == 0 and "failed" not in outcome.text, outcome.text
    assert "neutral rig poses" in " ".join(outcome.text.split())


def test_a_network_is_refined_in_the_solvers_mesh_space_whatever_its_own(run, toy):
    bundle = str(run("train", folder="trained").folder / "bundle")
    flipped = RigInMeshSpace(toy.source, MeshSpace(toy.source.rest_vertices, -toy.space.directions.flip(0)))
    meshes = PosedRig("poses", toy.source, poses(toy.source, 8))
    one, other = (Refined(rig, bundle).invert(meshes) for rig in (toy, flipped))
    errors = [evaluate_controls(toy.source, meshes, found).metrics["poses/mean_vertex_error_mm"] for found in (one, other)]
    assert errors[1] == pytest.approx(errors[0], rel=0.2)


def test_a_network_that_was_trained_again_is_compared_again(run, toy):
    prints = []
    for seed in (0, 1):
        bundle = run("train", f"seed={seed}", folder=f"trained{seed}").folder / "bundle"
        prints.append(Network(toy, str(bundle)).fingerprint)
    assert prints[0] != prints[1]
    staged = run("train", "model=inverse", folder="staged").folder / "bundle"
    with pytest.raises(InputError, match="holds another network"):
        HoldenNetwork(toy, None, bundle=str(staged))


def test_what_does_not_suit_the_rig_is_left_out_and_said_so(run):
    box = "rig._target_=tests.support.toys.BlackBox"
    outcome = run("compare", *TOY, box, "methods=[neutral,direct]", "mesh_space.samples=60")
    assert outcome.code == 0, outcome.text
    assert {method for method, _ in rows_of(outcome)} == {"neutral"}
    assert "Left out: direct, for no gradient passes through it." in outcome.text
    refused(run("compare", *TOY, box, "methods=[direct]", "mesh_space.samples=60", folder="other"), "direct: no gradient")


def test_rigs_with_a_fitted_basis_have_an_upper_bound_of_the_optimum(run, tmp_path):
    written(tmp_path / "a.dna", many_joints().file())
    settings = ["rig=dna", "rig.file=a.dna", "poses=8", "mesh_space.samples=60", "mesh_space.residual_mm=1.0"]
    outcome = run("compare", *settings, "methods=[neutral]", small=False)
    assert outcome.code == 0, outcome.text
    assert float(rows_of(outcome)["neutral", "rig_poses"]["optimum_ratio"]) > 2
    assert ">= " in (outcome.folder / "compare.md").read_text()


def test_a_trained_network_is_compared_and_refined(run, toy, tmp_path):
    bundle = run("train", folder="trained").folder / "bundle"
    config = ["methods=[network,refined]", f"methods.network.bundle={bundle}", f"methods.refined.bundle={bundle}"]
    rows = rows_of(run("compare", *TOY, *config))
    assert all(float(rows[name, "rig_poses"]["training_seconds"]) > 0.05 for name in ("network", "refined"))  # its bundle's
    plain, refined = (float(rows[name, "rig_poses"]["mean_vertex_error_mm"]) for name in ("network", "refined"))
    assert refined < 0.5 * plain
    plain, refined, stepped = (
        run("evaluate", f"bundle={bundle}", *TOY, setting, folder=setting).metrics
        for setting in ("refine=0", "refine=5", "mean_steps=4")
    )
    assert stepped["rig_poses/mean_vertex_error_mm"] < 0.8 * plain["rig_poses/mean_vertex_error_mm"]
    assert refined["rig_poses/mean_vertex_error_mm"] < 0.5 * plain["rig_poses/mean_vertex_error_mm"]
    assert plain["rig_poses/optimum_mean_vertex_error_mm"] == refined["rig_poses/optimum_mean_vertex_error_mm"]
    assert plain["rig_poses/optimum_ratio"] > refined["rig_poses/optimum_ratio"]
    capture = write_npz(tmp_path / "take.npz", performance(toy.source, 8), toy.source.faces.numpy())
    fewer = run(
        "evaluate", f"bundle={bundle}", *TOY, "refine=5", "fewer_controls=true", f"capture={capture}", folder="fewer"
    ).metrics
    assert fewer["rig_poses/active_controls"] <= refined["rig_poses/active_controls"]
    frames = take(toy.source)
    expected = load_inverse(bundle, toy.source, mean_steps=4)(frames.vertices(0, 8))
    torch.testing.assert_close(Network(toy, str(bundle), mean_steps=4).invert(frames), expected, rtol=0, atol=1e-4)
    few_again = Refined(toy, str(bundle), fewer_controls=True).invert(take(toy.source))
    assert_fewer(toy.source, few_again, Refined(toy, str(bundle)).invert(take(toy.source)))


@pytest.mark.parametrize("method", [LevenbergMarquardt, Clip])
def test_solvers_with_fewer_controls(method, toy):
    options = {"smoothness": 1e-3} if method is Clip else {}
    few, all_of_them = (method(toy, fewer_controls=fewer, **options) for fewer in (True, False))
    assert_fewer(toy.source, few.invert(take(toy.source)), all_of_them.invert(take(toy.source)))


def take(rig):
    """Frames in which the macro of the toy rises, which does what two others do together."""
    curve = torch.zeros(8, len(rig.controls))
    curve[:, 6] = torch.linspace(0.2, 0.9, 8)
    meshes = PosedRig("take", rig, curve)
    meshes.fps = 24.0
    return meshes


def assert_fewer(rig, few, all_of_them):
    assert int((few.abs() > 0.02).sum()) <= min(8, int((all_of_them.abs() > 0.02).sum()))
    assert float((few[:, 6] - take(rig).controls[:, 6]).abs().max()) < 0.02
    assert float((rig(few) - rig(take(rig).controls)).norm(dim=2).mean()) < 0.05


class Liar(Method):
    """Gives controls that are not what they should be."""

    def __init__(self, rig, wrong):
        super().__init__(rig)
        self.wrong = wrong

    def invert(self, meshes):
        right = Neutral(self.rig).invert(meshes)
        return {"short": right[1:], "nan": right * torch.nan, "beyond": right + 2}[self.wrong]


@pytest.mark.parametrize("wrong", ["short", "nan", "beyond"])
def test_a_method_that_gives_no_controls_is_named(toy, wrong):
    with pytest.raises(InputError, match="method 'liar' gave controls"):
        evaluated_row("liar", Liar(toy, wrong), toy.source, PosedRig("poses", toy.source, poses(toy.source, 4)), 0.0)


def test_no_method_sees_the_answer(toy):
    assert Clocked(PosedRig("poses", toy.source, poses(toy.source, 4))).controls is None


def test_the_optimum_is_kept_and_follows_the_rig(toy, tmp_path, monkeypatch):
    monkeypatch.setenv("RIGINV_CACHE", str(tmp_path))
    sets = [PosedRig("poses", toy.source, poses(toy.source, 5))]
    first = find_optima(toy.source, sets)["poses"]
    assert first.mean_mm < 0.02 and len(list(tmp_path.glob("optimum-*"))) == 1
    torch.testing.assert_close(find_optima(toy.source, sets)["poses"].errors_mm, first.errors_mm, atol=0, rtol=0)
    find_optima(toy.source, [PosedRig("poses", toy.source, poses(toy.source, 6))])
    assert len(list(tmp_path.glob("optimum-*"))) == 2
