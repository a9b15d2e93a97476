"""The train command and the files that it writes."""

import re
import shutil

import pytest
import torch
import yaml
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.custom_scalar import layout_pb2
from tensorboard.plugins.hparams import plugin_data_pb2

from riginv.rig.contract import check_rig
from rigs.surrogate import SurrogateRig
from tests.conftest import ROOT
from tests.support.toys import ToyRig

ERRORS = ("mean_vertex_error_mm", "max_vertex_error_mm", "mean_of_max_vertex_error_mm", "neutral_mean_vertex_error_mm")


@pytest.mark.parametrize("model", ["inverse", "holden"])
def test_a_run_leaves_everything_behind(run, model):
    made = run("train", f"model={model}", "seed=3", "model.network.hidden=[32]", "pictures.final=true")
    assert made.code == 0, made.text
    for name in ("random_combinations", "rig_poses", "simulated_performance"):
        for key in ERRORS:
            assert made.metrics[f"{name}/{key}"] >= 0
    assert made.metrics["simulated_performance/roughness"] >= 0
    assert (made.metrics["train/steps"], made.metrics["seed"]) == (12, 3)
    assert made.metrics["train/seconds"] > 0
    assert yaml.safe_load((made.folder / "config.yaml").read_text())["data"]["batch_size"] == 8
    for name in ("bundle.yaml", "weights.safetensors", "space.safetensors", "SHA256SUMS"):
        assert (made.folder / "bundle" / name).is_file()
    assert torch.load(made.folder / "checkpoints/last.ckpt", weights_only=True)["global_step"] == 12
    assert (made.folder / "poses.png").read_bytes()[:4] == b"\x89PNG"
    assert "true rig, toy" in made.text and "simulated performance" in made.text


def test_a_surrogate_is_trained_and_keeps_the_contract(run):
    forward = run("train", "model=forward", "model.network.hidden=[32]")
    assert forward.code == 0, forward.text
    judged = [key for key in forward.metrics if key.endswith("/mean_vertex_error_mm")]
    assert judged == ["rig_poses/mean_vertex_error_mm"]
    surrogate = SurrogateRig(str(forward.folder))
    assert surrogate.control_names == ToyRig().control_names and surrogate.has_blendshapes
    check_rig(surrogate)


def test_an_inverse_is_trained_through_a_surrogate_and_judged_by_the_true_rig(run):
    forward = run("train", "model=forward", "model.network.hidden=[32]", folder="forward")
    through = ["rig=surrogate", f"rig.bundle={forward.folder}"]
    refused = run("train", *through, folder="inverse")
    assert refused.code == 1 and "tests.support.toys.ToyRig is not allowed" in refused.text  # a bundle names no code of others
    made = run("train", *through, "true_rig=toy", folder="inverse")  # the user does
    assert made.code == 0, made.text
    assert made.metrics["true_rig"] == "toy" and (made.folder / "bundle/rig/bundle.yaml").is_file()
    shutil.rmtree(forward.folder)  # the inverse's bundle holds all that it needs
    again = run(
        "evaluate", f"bundle={made.folder}", "true_rig=toy", f"--config-dir={ROOT / 'tests/conf'}", "poses=20", folder="again"
    )
    assert again.code == 0, again.text
    key = "rig_poses/mean_vertex_error_mm"
    assert again.metrics[key] == pytest.approx(made.metrics[key], rel=1e-5)


def test_capture_noise_is_added_where_it_is_asked_for(run):
    clean = run("train", folder="clean")
    noisy = run("train", "noise.vertex_mm=0.5", "noise.smooth_mm=1", folder="noisy")
    assert noisy.code == 0, noisy.text
    weights = [load_file(made.folder / "bundle/weights.safetensors") for made in (clean, noisy)]
    assert weights[1]["coordinate_scale"] != weights[0]["coordinate_scale"]
    key = "rig_poses/neutral_mean_vertex_error_mm"
    assert noisy.metrics[key] == clean.metrics[key]  # judged on clean meshes all the same


def test_a_run_killed_while_it_was_judged_is_judged_again(run):
    made = run("train")
    (made.folder / "metrics.json").unlink()
    (made.folder / ".bundle.123.part").mkdir()
    (made.folder / "checkpoints/.last.ckpt.123.part").write_bytes(b"half")
    again = run("train", "resume=true")
    assert again.code == 0 and again.metrics == made.metrics
    assert not list(made.folder.rglob(".*.part"))


def test_tensorboard_shows_losses_errors_rates_pictures_and_hparams(run):
    made = run("train", "pictures.every_n_validations=1")
    events = EventAccumulator(str(made.folder), size_guidance={"images": 0})
    events.Reload()
    tags = events.Tags()
    for tag in ("train/loss", "train/rms_vertex_error_mm", "val/rig_poses/mean_vertex_error_mm", "lr-Adam"):
        assert tag in tags["scalars"], tags["scalars"]
    assert "poses/random_combinations" in tags["images"]
    result = events.Scalars("result/rig_poses/mean_vertex_error_mm")[-1].value
    assert result == pytest.approx(made.metrics["rig_poses/mean_vertex_error_mm"], rel=1e-5)
    assert "_hparams_/session_start_info" in events.summary_metadata


def test_tensorboards_dashboard_shows_errors_beside_neutral_and_the_optimum(run):
    made = run("train", "data.steps_per_epoch=4")
    events = EventAccumulator(str(made.folder), size_guidance={"tensors": 0, "scalars": 0})
    events.Reload()
    held = events.Tensors("custom_scalars__config__")[0].tensor_proto.string_val[0]
    shown = layout_pb2.Layout.FromString(held)
    validation, training = shown.category
    assert [chart.title for chart in validation.chart] == [
        "random combinations: mean error, mm",
        "rig poses: mean error, mm",
        "simulated performance: mean error, mm",
    ]
    assert [chart.title for chart in training.chart] == ["loss", "root mean square error, mm", "learning rate"]
    tags = events.Tags()["scalars"]
    for chart in (*validation.chart, *training.chart):
        for pattern in chart.multiline.tag:
            assert [tag for tag in tags if re.search(pattern, tag)], f"{chart.title}: no tag is like {pattern}"
    neutral = events.Scalars("val/rig_poses/neutral_mean_vertex_error_mm")
    assert [point.step for point in neutral] == [0, 4, 8, 12]
    assert neutral[0].value == pytest.approx(made.metrics["rig_poses/neutral_mean_vertex_error_mm"], rel=0.7)  # of other poses
    optimum = events.Scalars("val/simulated_performance/optimum_mean_vertex_error_mm")
    assert {point.step for point in optimum} == {0, 12}
    assert optimum[0].value == pytest.approx(made.metrics["simulated_performance/optimum_mean_vertex_error_mm"], rel=1e-5)
    content = events.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    columns = set(plugin_data_pb2.HParamsPluginData.FromString(content).session_start_info.hparams)
    assert {"seed", "model.optimizer.lr", "data.steps_per_epoch"} <= columns and len(columns) < 20


def test_the_same_seed_gives_the_same_weights_and_another_does_not(run):
    weights = [
        load_file(run("train", f"seed={seed}", folder=name).folder / "bundle/weights.safetensors")
        for seed, name in ((0, "a"), (0, "b"), (1, "c"))
    ]
    assert all(torch.equal(weights[0][key], weights[1][key]) for key in weights[0])
    assert not all(torch.equal(weights[0][key], weights[2][key]) for key in weights[0])


def test_a_sweep_ends_in_one_table_and_counts_what_failed(run, tmp_path):
    made = run("train", "-m", "seed=0,1", "model=inverse,holden", f"hydra.sweep.dir={tmp_path / 'sweep'}")
    assert made.code == 0, made.text
    rows = (tmp_path / "sweep/sweep.csv").read_text().splitlines()
    assert len(rows) == 5 and "rig_poses/mean_vertex_error_mm" in rows[0]
    assert made.text.count("finished") == 0 and "Mean vertex error" in made.text
    made = run("train", "-m", "model.optimizer.lr=-1,0.001", f"hydra.sweep.dir={tmp_path / 'second'}")
    assert made.code == 1 and "1 of 2 jobs failed" in made.text
    assert "model.optimizer.lr is -1" in made.text


@pytest.mark.parametrize("name", ["train", "evaluate", "check"])
def test_help_explains_every_group(run, name):
    text = run(name, "--help", small=False).text
    for group in ("rig", "true_rig") if name != "check" else ("rig",):
        assert group in text
    if name == "train":
        for word in ("model", "sampler", "trainer", "experiment", "staged", "paper/inverse", "--config-dir"):
            assert word in text
