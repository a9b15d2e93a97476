"""Sweeps: one table, resumed to what is missing, the same in whatever processes the jobs run."""

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tensorboard.backend.event_processing import data_provider, plugin_event_multiplexer
from tensorboard.context import RequestContext
from tensorboard.plugins import base_plugin
from tensorboard.plugins.hparams import api_pb2, backend_context, get_experiment, list_session_groups

from riginv.errors import InputError
from riginv.launch.sweep_folder import job_name, new_sweep_folder, with_sweep_folder
from riginv.launch.sweep_record import read_records
from riginv.launch.sweep_rows import shown
from tests.conftest import ROOT, SMALL

ERROR = "rig_poses/mean_vertex_error_mm"
TYPED = "hydra:\n  job: {config_name: train}\n  overrides: {task: ['seed=0,1', 'rig=face']}\n"


def rows_of(sweep: Path) -> list[dict]:
    with (sweep / "sweep.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def swept(run, tmp_path) -> Path:
    """The folder of a sweep of two models and two seeds, one of them refused."""
    sweep = tmp_path / "sweep"
    made = run("train", "-m", "seed=0,-1", "model=holden,inverse", f"hydra.sweep.dir={sweep}")
    assert made.code == 1 and "2 of 4 jobs failed" in made.text, made.text
    assert made.text.count("seed is -1") == 4, made.text  # as it happens, and at the end
    return sweep


def test_a_sweep_is_one_table_sorted_and_resumed_to_what_is_missing(run, swept):
    rows = rows_of(swept)
    assert [row["state"] for row in rows] == ["finished", "finished", "failed", "failed"]
    assert float(rows[0][ERROR]) < float(rows[1][ERROR])
    assert {(row["seed"], row["model"]) for row in rows[:2]} == {("0", "inverse"), ("0", "holden")}
    text = (swept / "sweep.md").read_text().splitlines()
    assert text[0].startswith("| seed | model | state | random combinations | rig poses |") and len(text) == 8
    assert {path.name for path in swept.iterdir() if path.is_dir()} == {
        *("00_seed-0_model-holden", "01_seed-0_model-inverse", "02_seed--1_model-holden", "03_seed--1_model-inverse", "jobs"),
    }
    assert (swept / "03_seed--1_model-inverse/failure.txt").read_text().startswith("seed is -1, expected")
    assert_tensorboard_shows_one_table(swept, rows)

    shutil.rmtree(swept / "01_seed-0_model-inverse")  # as if it had never been
    (swept / "jobs/01_seed-0_model-inverse.json").unlink()
    kept = (swept / "00_seed-0_model-holden/metrics.json").stat().st_mtime_ns
    again = run("train", "-m", "resume=true", f"hydra.sweep.dir={swept}", f"--config-dir={ROOT / 'tests/conf'}", small=False)
    assert again.code == 1 and "2 of 4 jobs failed" in again.text, again.text
    assert "seed=0 model=holden  finished before" in again.text
    assert (swept / "00_seed-0_model-holden/metrics.json").stat().st_mtime_ns == kept
    assert [row[ERROR] for row in rows_of(swept)] == [row[ERROR] for row in rows]
    assert [record.starts for record in read_records(swept)] == [1, 1, 2, 2]


def assert_tensorboard_shows_one_table(sweep: Path, rows: list[dict]) -> None:
    """Ask TensorBoard's own HPARAMS backend what its page would show of the whole folder."""
    multiplexer = plugin_event_multiplexer.EventMultiplexer()
    multiplexer.AddRunsFromDirectory(str(sweep))
    multiplexer.Reload()
    provider = data_provider.MultiplexerDataProvider(multiplexer, str(sweep))
    context = backend_context.Context(base_plugin.TBContext(data_provider=provider, multiplexer=multiplexer))
    columns = get_experiment.Handler(RequestContext(), context, "", api_pb2.GetExperimentRequest()).run()
    assert [metric.name.tag for metric in columns.metric_infos][1] == f"result/{ERROR}"
    differing = [column.name for column in columns.hparam_infos if column.differs]
    assert "model._target_" in differing and "seed" not in differing  # of those that finished
    names = [column.name for column in columns.hparam_infos]
    assert names.index("model._target_") < names.index("seed") and "model.sampled_vertices" in names
    request = api_pb2.ListSessionGroupsRequest(start_index=0, slice_size=9, allowed_statuses=range(4))
    for name in ("seed", "model._target_"):
        request.col_params.add(hparam=name)
    request.col_params.add(metric=api_pb2.MetricName(tag=f"result/{ERROR}"))
    groups = list_session_groups.Handler(RequestContext(), context, "", request).run().session_groups
    shown = {group.name: group for group in groups}
    finished = [row for row in rows if row["state"] == "finished"]
    assert set(shown) == {row["folder"] for row in finished}
    for row in finished:
        values = {value.name.tag: value.value for value in shown[row["folder"]].metric_values}
        assert values[f"result/{ERROR}"] == pytest.approx(float(row[ERROR]), rel=1e-5)
        assert row["model"] in shown[row["folder"]].hparams["model._target_"].string_value


@pytest.mark.slow
def test_joblib_gives_what_one_process_gives(run, tmp_path, monkeypatch):
    pytest.importorskip("joblib", reason="joblib is not installed: pip install 'riginv[sweeps]'")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    here = run("train", "model=holden", "seed=3")
    sweep = tmp_path / "sweep"
    made = run("train", "-m", "hydra/launcher=joblib", "model=holden", "seed=3,-1", f"hydra.sweep.dir={sweep}")
    assert made.code == 1 and "seed=-1  failed in" in made.text and "1 of 2 jobs failed" in made.text, made.text
    rows = rows_of(sweep)
    assert [row["state"] for row in rows] == ["finished", "failed"] and rows[1]["why"].startswith("seed is -1")
    assert float(rows[0][ERROR]) == pytest.approx(here.metrics[ERROR], rel=1e-6)  # with other threads
    assert "true rig, toy" in (sweep / "jobs/00_seed-3.log").read_text()


def test_a_sweep_of_checks_needs_no_metrics(run, tmp_path):
    made = run("check", "-m", "rig=toy,plain", f"--config-dir={ROOT / 'tests/conf'}", f"hydra.sweep.dir={tmp_path / 'sweep'}")
    assert made.code == 0, made.text
    assert [(row["rig"], row["state"]) for row in rows_of(tmp_path / "sweep")] == [("toy", "finished"), ("plain", "finished")]


def test_cells_are_short():
    assert [shown(value) for value in (0.12345, 2119.966, 42, None, "face")] == ["0.123", "2,120", "42", "-", "face"]


def test_a_folder_is_named_by_what_is_swept(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = Path(new_sweep_folder("train", ["rig=toy", "seed=0,1", "model.network.hidden=[32,16]", "lr=range(1,3)"])).name
    assert name[19:] == "_train_seed-0-1_lr-range-1-3"
    (tmp_path / "multirun.yaml").write_text(TYPED)
    assert job_name(3, str(tmp_path), ["seed=1", "rig=face", "resume=true"]) == "03_seed-1"


def test_the_same_command_finds_its_sweep_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = Path("runs/sweep/first")
    (folder / "jobs").mkdir(parents=True)
    (folder / "multirun.yaml").write_text(TYPED)
    same = ["-m", "rig=face", "seed=0,1", "resume=true"]
    wanted = ["-m", "resume=true", "seed=0,1", "rig=face", f"hydra.sweep.dir={folder}"]
    assert with_sweep_folder(same, "train") == wanted
    assert with_sweep_folder(["-m", "resume=true", f"hydra.sweep.dir={folder}"], "train") == [
        *("-m", "resume=true", f"hydra.sweep.dir={folder}", "seed=0,1", "rig=face"),
    ]
    for left in (same[1:], same[:-1], [*same, "noise.vertex_mm=1"]):  # one run; a new sweep; another sweep
        assert with_sweep_folder(left, "train") == left
    assert with_sweep_folder(same, "compare") == same
    with pytest.raises(InputError, match="holds a sweep already: add resume=true"):
        with_sweep_folder(["-m", "seed=0,1", f"hydra.sweep.dir={folder}"], "train")
    with pytest.raises(InputError, match="holds another sweep, of seed=0,1 rig=face"):
        with_sweep_folder(["-m", "seed=0", f"hydra.sweep.dir={folder}", "resume=true"], "train")
    (folder / "jobs").rmdir()  # what was typed before was refused
    for free in (["-m", "seed=0,2", f"hydra.sweep.dir={folder}"], same):
        assert with_sweep_folder(free, "train") == free


@pytest.mark.slow
def test_the_comparison_of_rigs_and_models_is_six_jobs(run, tmp_path):
    few = ["trainer.max_steps=2", "data.batch_size=4", "evaluation.test_poses=6", "evaluation.validation_poses=2"]
    few += [
        "pictures.every_n_validations=null",
        "pictures.final=false",
        "trainer.log_every_n_steps=1",
        f"hydra.sweep.dir={tmp_path / 'sweep'}",
    ]
    made = run("train", "-m", "experiment=rigs_and_models", *few, small=False)
    assert made.code == 0, made.text
    rows = rows_of(tmp_path / "sweep")
    assert [row["rig"] for row in rows] == ["face"] * 3 + ["body"] * 3
    assert {row["model"] for row in rows} == {"inverse", "holden", "forward"}
    assert all(float(row[ERROR]) > 0 for row in rows)


@pytest.mark.slow
def test_a_search_by_optuna_goes_on_where_it_was(tmp_path):
    optuna = pytest.importorskip("optuna", reason="optuna is not installed: pip install 'riginv[search]'")
    small = [text for text in SMALL if not text.startswith(("rig=", "--config-dir", "data.batch_size"))]
    typed = [*small, "rig._target_=tests.support.toys.ToyRig", f"--out={tmp_path / 'search'}", "--trials=1"]
    for _ in range(2):
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        program = [sys.executable, str(ROOT / "examples/optuna_search.py"), *typed]
        made = subprocess.run(program, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert made.returncode == 0, made.stderr
    assert "The best of 2 trials" in made.stdout
    study = optuna.load_study(study_name="riginv", storage=f"sqlite:///{tmp_path / 'search/study.db'}")
    for trial in study.trials:
        metrics = json.loads((tmp_path / f"search/{trial.number:03d}/metrics.json").read_text())
        assert trial.value == metrics[ERROR]
