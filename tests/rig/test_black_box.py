"""Rigs that give meshes and nothing else: sampled live, or known by recorded poses alone."""

import numpy as np
import pytest
import torch

from riginv.rig.batches import generator_at
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.contract import check_rig
from riginv.rig.pairs import read_pairs, write_pairs
from riginv.rig.random_controls import sparse_controls
from rigs.pairs import PairsRig
from rigs.surrogate import SurrogateRig
from tests.conftest import ROOT
from tests.support.clips import performance, write_npz
from tests.support.toys import BlackBox, ToyRig

FEW = ["data.black_box_poses=60", "mesh_space.samples=40"]


@pytest.fixture(scope="module")
def table() -> dict[str, np.ndarray]:
    """Pairs as another program would write them."""
    rig = ToyRig()
    controls = sparse_controls(rig.lower, rig.upper, rig.neutral_controls, 7, 200, generator_at(3, "pairs"))
    arrays = {"controls": controls, "vertices": rig(controls), "rest_vertices": rig.rest_vertices, "faces": rig.faces}
    arrays |= {"lower": rig.lower, "upper": rig.upper, "neutral": rig.neutral_controls}
    return {**{key: value.numpy() for key, value in arrays.items()}, "control_names": np.array(rig.control_names)}


def test_a_black_box_is_fitted_to_its_poses():
    fitted = BlackBoxRig.sampled(BlackBox(), samples=100, residual_mm=1e-3)
    assert len(fitted.basis) <= 12 and not fitted.differentiable  # the toy has twelve shapes
    check_rig(fitted)
    controls = torch.rand(5, 7, generator=torch.Generator().manual_seed(0))
    assert (fitted(controls) - ToyRig()(controls)).norm(dim=2).max() < 0.01


def test_a_differentiable_rig_without_a_linear_end_is_trained_on_as_it_is(run):
    made = run("train", "rig=plain", *FEW, "model.network.quasi_newton_steps=0")  # they would leave rounding errors alone
    assert made.code == 0, made.text
    assert not (made.folder / "surrogate").exists()
    configs = f"--config-dir={ROOT / 'tests/conf'}"
    again = run("evaluate", f"bundle={made.folder}", "rig=plain", configs, "poses=20", folder="again")
    key = "rig_poses/mean_vertex_error_mm"
    assert again.code == 0 and again.metrics[key] == pytest.approx(made.metrics[key], rel=1e-4), again.text


def test_a_black_box_is_inverted_through_a_surrogate_in_one_command(run):
    made = run("train", "rig=black_box", *FEW)
    assert made.code == 0, made.text
    assert "first a surrogate" in made.text and made.metrics["true_rig"] == "black box"
    assert (made.folder / "surrogate/metrics.json").is_file() and (made.folder / "bundle/rig/bundle.yaml").is_file()
    again = run("train", "rig=black_box", *FEW, "resume=true")
    assert again.code == 0 and again.metrics == made.metrics


def test_a_black_box_has_holden_without_a_surrogate(run):
    made = run("train", "rig=black_box", "model=holden", *FEW)
    assert made.code == 0, made.text
    assert not (made.folder / "surrogate").exists()


@pytest.mark.parametrize("form", ["table.npz", "table", "table.zarr"])
def test_a_table_reads_as_it_was_written(table, tmp_path, form):
    path = write(table, tmp_path / form)
    read = read_pairs(path)
    np.testing.assert_array_equal(read.vertices, table["vertices"])
    assert [control.name for control in read.described] == table["control_names"].tolist()
    assert read.described[5].lower == -1


def test_what_is_held_out_is_not_trained_on(table, tmp_path):
    rig = PairsRig(str(write(table, tmp_path / "table.npz")))
    assert len(rig.held_out) == 20 and len(rig.training_set) == 180
    seen = {tuple(row) for row in rig.training_set.controls.tolist()}
    assert not any(tuple(row) in seen for row in rig.held_out.controls.tolist())
    basis = rig.basis.flatten(1).numpy()
    left = table["vertices"].reshape(200, -1) - table["rest_vertices"].reshape(-1)
    left = left - left @ np.linalg.pinv(basis) @ basis
    assert np.linalg.norm(left.reshape(200, -1, 3), axis=2).mean() < 0.01


@pytest.mark.parametrize("model", ["inverse", "holden"])
def test_a_table_is_inverted_with_no_rig_at_hand(run, table, tmp_path, model):
    path = write(table, tmp_path / "table.zarr")
    made = run("train", "rig=pairs", f"rig.file={path}", f"model={model}")
    assert made.code == 0, made.text
    assert made.metrics["true_rig"] == "none" and "The rig is recorded: errors are on held-out poses" in made.text
    surrogate = SurrogateRig(str(made.folder / "surrogate"))
    check_rig(surrogate)
    errors = (surrogate(torch.tensor(table["controls"])) - torch.tensor(table["vertices"])).norm(dim=2)
    held_out = PairsRig(str(path)).held_out
    rows = [table["controls"].tolist().index(row) for row in held_out.controls.tolist()]
    assert made.metrics["surrogate/mean_vertex_error_mm"] == pytest.approx(float(errors[rows].mean()), rel=1e-3)
    clip = write_npz(tmp_path / "take.npz", performance(ToyRig(), 12), ToyRig().faces.numpy())
    again = run("evaluate", f"bundle={made.folder}", f"capture={clip}", folder="again")
    assert again.code == 0, again.text
    key = "held_out_pairs/mean_vertex_error_mm"
    assert again.metrics[key] == pytest.approx(made.metrics[key], rel=1e-4)
    assert again.metrics["capture/neutral_mean_vertex_error_mm"] > 1 and "capture/mean_vertex_error_mm" in again.metrics


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"controls": None}, "no array 'controls'"),
        ({"vertices": np.zeros((3, 162, 3), np.float32)}, "expected 200 poses as in 'controls' where it has 3"),
        ({"vertices": np.full((200, 162, 3), np.nan, np.float32)}, "'vertices' holds NaN"),
        ({"control_names": np.arange(7)}, "expected text"),
        ({"control_names": np.array(["a"] * 7)}, "two controls are named 'a'"),
        ({"faces": np.zeros((4, 3), np.float32)}, "expected whole numbers"),
        ({"lower": np.ones(7, np.float32)}, "lower 1.0 >= upper 1.0"),
        ({"rest_vertices": np.zeros((162, 2), np.float32)}, "expected 3 where it has 2"),
    ],
)
def test_a_wrong_table_is_explained(run, table, tmp_path, change, expected):
    arrays = {key: value for key, value in (table | change).items() if value is not None}
    path = tmp_path / "table.npz"
    np.savez(path, **arrays)
    made = run("train", "rig=pairs", f"rig.file={path}", "model=forward")
    assert made.code == 1 and expected in made.text and str(path) in made.text.replace("\n", "")
    assert not made.folder.exists()


def test_a_table_is_no_judge_of_a_comparison(run, table, tmp_path):
    path = write(table, tmp_path / "table.npz")
    made = run("compare", "rig=pairs", f"rig.file={path}", "methods=[neutral]")
    assert made.code == 1 and "compare needs a rig that can be posed" in " ".join(made.text.split())
    assert not made.folder.exists()


def test_a_truncated_or_hostile_table_is_explained(run, table, tmp_path):
    path = write(table, tmp_path / "table.npz")
    path.write_bytes(path.read_bytes()[:5000])
    made = run("train", "rig=pairs", f"rig.file={path}")
    assert made.code == 1 and "no .npz, or a damaged one" in made.text
    np.savez(path, **{**table, "control_names": np.array([{"a": 1}] * 7, dtype=object)})
    made = run("train", "rig=pairs", f"rig.file={path}")
    assert made.code == 1 and "cannot be read" in made.text and "Traceback" not in made.text


def write(table, path):
    if path.suffix:
        write_pairs(path, table)
    else:
        path.mkdir()
        for name, array in table.items():
            np.save(path / f"{name}.npy", array)
    return path
