"""Each mistake of a user: one clear sentence, a non-zero exit, no traceback, and nothing left behind."""

import pytest


def refused(outcome, *says: str) -> None:
    assert outcome.code == 1, outcome.text
    assert "Traceback" not in outcome.text
    assert outcome.text.count("error:") == 1
    for words in says:
        assert words in " ".join(outcome.text.split()), outcome.text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["rig=fase"], "did you mean face"),
        (["model=invers"], "did you mean inverse"),
        (["true_rig=fcae"], "did you mean face"),
        (["model/network=stagd"], "did you mean staged"),
        (["experiment=paper/invers"], "did you mean paper/inverse"),
        (["trainer.max_step=3"], "did you mean trainer.max_steps"),
        (["nonsense"], "cannot read the argument 'nonsense'"),
        (["rig=surrogate"], "rig.bundle must be given"),
        (["rig=surrogate", "rig.bundle=nowhere"], "nowhere: no bundle there"),
        (["rig._target_=no.such.Rig"], "cannot find the class no.such.Rig"),
        (["rig._target_=os.getcwd"], "os.getcwd is not a class"),
        (["+rig.colour=red"], "colour"),
        (["capture=none.csv"], "none.csv: no such file"),
        (["trainer.max_steps=-5"], "trainer.max_steps is -5"),
        (["trainer.max_steps=0"], "trainer.max_steps is 0"),
        (["trainer.devices=0"], "trainer.devices is 0"),
        (["trainer.accelerator=gpu"], "trainer.accelerator=gpu"),
        (["trainer.accelerator=abacus"], "trainer.accelerator=abacus"),
        (["data.batch_size=0"], "data.batch_size is 0"),
        (["data.steps_per_epoch=-1"], "data.steps_per_epoch is -1"),
        (["data.stored_poses=0"], "data.stored_poses is 0"),
        (["evaluation.test_poses=-3"], "evaluation.test_poses is -3"),
        (["model.optimizer.lr=-1"], "model.optimizer.lr is -1"),
        (["model.optimizer.lr=nan"], "model.optimizer.lr is nan"),
        (["model.optimizer.lr=inf"], "model.optimizer.lr is inf"),
        (["model.optimizer.lr=fast"], "model.optimizer.lr is 'fast'"),
        (["model.network.hidden=[32,0]"], "model.network.hidden is [32, 0]"),
        (["model.network.stages=0"], "model.network.stages is 0"),
        (["model.network.activation=sine"], "activation 'sine'"),
        (["noise.vertex_mm=-0.1"], "noise.vertex_mm is -0.1"),
        (["sampler.fractions.sparse_poses=-1"], "sampler.fractions.sparse_poses is -1"),
        (["sampler=plausible_poses", "sampler.controls.weak_fraction=2"], "weak_fraction is 2"),
        (["sampler=sparse_poses", "sampler.controls.max_active=8"], "max_active is 8, expected 1 to 7"),
        (["seed=-1"], "seed is -1"),
        (["checkpoint.every_n_steps=0"], "checkpoint.every_n_steps is 0"),
    ],
)
def test_a_mistake_is_named_before_anything_starts(run, arguments, says):
    outcome = run("train", *arguments)
    refused(outcome, says)
    assert not outcome.folder.exists()


def test_nothing_is_left_under_runs_either(run, tmp_path):
    refused(run("train", "rig=fase", "hydra.run.dir=${run_folder:false,toy,x}"))
    refused(run("train", "seed=-1", "hydra.run.dir=${run_folder:false,toy,x}"))
    assert not (tmp_path / "runs").exists()


def test_an_existing_run_is_never_overwritten(run):
    first = run("train")
    before = {path: path.read_bytes() for path in first.folder.rglob("*") if path.is_file()}
    refused(run("train"), "holds a run already", "resume=true")
    refused(run("train", "seed=5", "resume=true"), "seed was 0, now 5")
    assert {path: path.read_bytes() for path in first.folder.rglob("*") if path.is_file()} == before
    again = run("train", "resume=true")
    assert again.code == 0 and again.metrics == first.metrics


def test_a_folder_of_other_things_is_left_alone(run, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run/thesis.tex").write_text("years of work")
    refused(run("train"), "no run of riginv")
    refused(run("train", "resume=true"), "no run of riginv")
    assert (tmp_path / "run/thesis.tex").read_text() == "years of work"


def test_evaluate_names_its_mistakes(run):
    refused(run("evaluate", small=False), "name a bundle")
    refused(run("evaluate", "bundle=nowhere", small=False), "nowhere: no bundle there")
    refused(run("evaluate", "bundle=nowhere", "poses=0", small=False), "poses is 0")


def test_a_loss_that_becomes_nan_stops_the_run_and_keeps_the_last_good_checkpoint(run):
    outcome = run("train", "model.optimizer.lr=1e30", "checkpoint.every_n_steps=1", "trainer.max_steps=50")
    refused(outcome, "the loss became", "at step")
    assert not (outcome.folder / "metrics.json").exists() and not (outcome.folder / "bundle").exists()


def test_a_bug_is_not_passed_off_as_a_users_mistake(run, monkeypatch):
    monkeypatch.setattr("riginv.train.build_rig", lambda *arguments: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("train")


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("contact_sheet", ["rig=face", "out=old.png"]),
        ("export_onnx", ["bundle=nowhere", "out=old.onnx"]),
        ("copy_dna", ["file=none.dna", "out=old.dna"]),
        ("evaluate_dna", ["file=none.dna", "inputs=none.npz", "out=old.npz"]),
        ("gui_dna", ["file=none.dna", "curves=none.csv", "out=old.csv"]),
        ("export_dna", ["rig=face", "out=old.dna"]),
        ("export_blender", ["rig=face", "out=old.blend"]),
    ],
)
def test_outputs_that_exist_are_refused_before_work_starts(command, arguments, run, tmp_path):
    old = tmp_path / arguments[-1].removeprefix("out=")
    old.write_text("kept")
    refused(run(command, *arguments), f"out={old.name}: it is there already; give another name, or remove it")
    assert old.read_text() == "kept" and list(tmp_path.iterdir()) == [old]
