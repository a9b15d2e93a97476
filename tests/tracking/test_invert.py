"""python -m riginv.invert as users type it: what it leaves, what it says, and that nothing half-done looks finished."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from riginv.clips.open import open_sequence
from tests.conftest import ROOT
from tests.support.clips import obj_sequence, performance, reading_options, write_npz
from tests.support.toys import ToyRig

TOY = ("rig=toy", f"--config-dir={ROOT / 'tests/conf'}")
PLAIN = ("look.page=false", "look.sheet=false")


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig()


@pytest.fixture
def clip(rig, tmp_path) -> Path:
    return write_npz(tmp_path / "take.npz", performance(rig, 20), rig.faces.numpy())


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_clip_becomes_curves_and_judged_frames(run, clip, tmp_path):
    outcome = run("invert", *TOY, f"clip={clip}", "out=curves", "formats=[anim]")
    assert outcome.code == 0, outcome.text
    out = tmp_path / "curves"
    names = {"curves.csv", "curves.json", "frames.csv", "curves.anim", "look.html", "frames.png"}
    assert {path.name for path in out.iterdir()} == names
    frames, curves = rows(out / "frames.csv"), rows(out / "curves.csv")
    assert len(frames) == len(curves) == 20
    assert max(float(row["mean_error_mm"]) for row in frames) < 0.5
    assert "bump0" in curves[0] and json.loads((out / "curves.json").read_text())["fps"] == 24
    for said in (
        "20 frames at 24 a second",
        "units of mm guessed",
        "Evaluated by the true rig, toy",
        "Worst frames",
        "curves.anim",
    ):
        assert said in outcome.text
    assert not list(tmp_path.glob(".*.part"))


def test_what_is_written_as_an_avatar_is_the_clip_again(run, rig, tmp_path):
    """Out as glTF, in as a clip, rigid motion included: the meshes that were asked for."""
    meshes = performance(rig, 20)
    angle = np.linspace(0, 1.2, 20)
    turn = np.stack([np.cos(angle), 0 * angle, np.sin(angle), 0 * angle, 1 + 0 * angle, 0 * angle], axis=1).reshape(20, 2, 3)
    turn = np.concatenate([turn, np.cross(turn[:, :1], turn[:, 1:])], axis=1)
    world = meshes @ turn.transpose(0, 2, 1) + 300 * np.stack([angle, 0 * angle, angle], axis=1)[:, None]
    clip = write_npz(tmp_path / "take.npz", world, rig.faces.numpy())
    outcome = run("invert", *TOY, *PLAIN, f"clip={clip}", "out=o", "formats=[glb]", "method=levenberg_marquardt")
    assert outcome.code == 0, outcome.text
    assert "Rigid motion was removed: up to " in outcome.text
    again = open_sequence(str(tmp_path / "o/animation.glb"), rig, reading_options())
    assert len(again) == 20 and np.linalg.norm(1000 * again.read(0, 20) - world, axis=2).mean() < 0.1


@pytest.mark.parametrize("method", ["levenberg_marquardt", "clip"])
def test_sequences_of_files_and_keys_and_another_rate(method, run, rig, tmp_path):
    pattern = obj_sequence(tmp_path / "shot", performance(rig, 20) / 10, rig.faces.numpy())
    outcome = run(
        "invert", *TOY, *PLAIN, f"clip={pattern}", "out=curves", f"method={method}", "after.keys_mm=0.5", "after.fps=60"
    )
    assert outcome.code == 0, outcome.text
    assert "units of cm guessed" in outcome.text and "keys are kept" in outcome.text
    assert rows(tmp_path / "curves/frames.csv")[0]["frame"] == "1001" and len(rows(tmp_path / "curves/curves.csv")) == 39


def active(path) -> int:
    """The number of values of the controls in a table of curves that are not nearly neutral."""
    names = ToyRig().control_names
    return sum(abs(float(row[name])) > 0.02 for row in rows(path) for name in names)


def test_a_trained_network_inverts_alone_and_refined(run, rig, clip, tmp_path):
    assert run("train").code == 0
    bundle = (f"bundle={tmp_path / 'run'}", *TOY, f"clip={clip}", *PLAIN)
    errors = {}
    for name, options in (("network", ()), ("refined", ("refine=8",)), ("clip", ("method=clip", "solver.smoothness=0.01"))):
        outcome = run("invert", *bundle, f"out={name}", *options)
        assert outcome.code == 0, outcome.text
        facts = json.loads((tmp_path / name / "curves.json").read_text())["made_by"]
        assert facts["method"] == name and len(facts["bundle"]) == 64
        errors[name] = np.mean([float(row["mean_error_mm"]) for row in rows(tmp_path / name / "frames.csv")])
    assert errors["refined"] < errors["network"] and errors["clip"] < errors["network"]
    for name, options in (("refined", ["refine=8"]), ("clip", ["method=clip", "solver.smoothness=0.01"])):
        fewer = run("invert", *bundle, f"out=fewer_{name}", "solver.fewer_controls=true", *options)
        assert fewer.code == 0, fewer.text
        some, all_of_them = (active(tmp_path / f"{folder}/curves.csv") for folder in (f"fewer_{name}", name))
        assert some <= all_of_them
        error = np.mean([float(row["mean_error_mm"]) for row in rows(tmp_path / f"fewer_{name}/frames.csv")])
        assert error < max(1.05 * errors[name], errors[name] + 1e-3)
    stepped = run("invert", *bundle, "out=stepped", "mean_steps=4")
    assert stepped.code == 0, stepped.text
    assert np.mean([float(row["mean_error_mm"]) for row in rows(tmp_path / "stepped/frames.csv")]) < errors["network"]
    refused = run("invert", *bundle, "out=refused", "mean_steps=4", "refine=8")
    assert refused.code == 1 and "mean_steps=4 is for method=network" in refused.text
    held = run("invert", *bundle, "out=held", "controls.freeze=[bump*]")
    assert held.code == 0 and all(float(row["bump0"]) == 0 for row in rows(tmp_path / "held/curves.csv"))
    refused = run("invert", *bundle, "out=refused", "controls.symmetric=[[bump0,bump1]]")
    assert refused.code == 1 and "controls.symmetric is for solvers" in refused.text
    refused = run("invert", *bundle, "out=refused", "solver.fewer_controls=true")
    assert refused.code == 1 and "solver.fewer_controls is for solvers" in refused.text


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["out=o"], "clip must be given"),
        (["clip=none.npz", "out=o"], "none.npz: no such file"),
        (["clip={clip}", "out=o", "method=magic"], "method is 'magic', expected network or refined or"),
        (["clip={clip}", "out=o", "method=network"], "needs a trained network: give bundle=DIR"),
        (["clip={clip}", "out=o", "refine=3", "method=levenberg_marquardt"], "refine=3 is for"),
        (["clip={clip}", "out=o", "formats=[gif]"], "formats: 'gif' is not known"),
        (["clip={clip}", "out=o", "reading.unit=m"], "and that of rig 'toy' 100 mm"),
        (["clip={clip}", "out=o", "reading.fps=0"], "reading.fps is 0"),
        (["clip={clip}", "out=o", "reading.up=q"], "reading.up is 'q'"),
        (["clip={clip}", "out=o", "reading.missing_frames=maybe"], "reading.missing_frames"),
        (["clip={clip}", "out=o", "frames.first=500"], "none left"),
        (["clip={clip}", "out=o", "frames.exclude=[500]"], "frames.exclude names 500"),
        (["clip={clip}", "out=o", "motion=perhaps"], "motion is 'perhaps'"),
        (["clip={clip}", "out=o", "vertices.weights={nose: 0}"], "no such region"),
        (["clip={clip}", "out=o", "controls.freeze=[jaw*]"], "no such control"),
        (["clip={clip}", "out=o", "window=0"], "window is 0"),
        (["clip={clip}", "out=o", "frames.exclude=17"], "expected a list of frames"),
        (["clip={clip}", "out=o", "controls.freeze=null"], "expected a list of names or globs"),
        (["clip={clip}", "out=o", "formats=glb"], "expected a list: formats=[csv,glb]"),
        (["clip={clip}", "out=o", "vertices.weights=3"], "vertices.weights is 3"),
        (["clip={clip}", "out=o", "controls.mask=3"], "3: no such file"),
        (["clip={clip}", "out=o", "reading.vertices=none.npy"], "none.npy: no such file"),
        (["clip=" + 300 * "x" + ".npz", "out=o"], "File name too long"),
        (["clip={clip}", "out=o", "after.fps=-1"], "after.fps is -1"),
        (["clip={clip}", "out={clip}"], "it is there already"),
        (
            ["clip=take.c3d", "out=got"],
            "take.c3d: markers, which riginv.invert takes with correspondence=markers markers=MAP.yaml",
        ),
        (["clip={clip}", "out=o", "bundle=none"], "no bundle there"),
    ],
)
def test_mistakes_end_in_one_sentence_and_leave_nothing(arguments: list[str], said: str, run: Callable, clip, tmp_path):
    before = set(tmp_path.iterdir())
    outcome = run("invert", *TOY, *(argument.format(clip=clip) if "{clip}" in argument else argument for argument in arguments))
    assert outcome.code == 1 and said in outcome.text, outcome.text
    assert "Traceback" not in outcome.text
    assert set(tmp_path.iterdir()) - before <= {tmp_path / "run"}


def test_a_clip_that_breaks_midway_leaves_nothing(run, rig, tmp_path):
    pattern = obj_sequence(tmp_path / "shot", performance(rig, 20), rig.faces.numpy())
    last = tmp_path / "shot/shot.1019.obj"
    last.write_text(last.read_text()[:-9000])
    outcome = run("invert", *TOY, f"clip={pattern}", "out=curves", "window=4", "method=levenberg_marquardt")
    assert outcome.code == 1 and "shot.1019.obj" in outcome.text and "Traceback" not in outcome.text
    assert not (tmp_path / "curves").exists() and not list(tmp_path.glob(".*.part"))


def test_neither_a_rig_nor_a_bundle(run, clip):
    outcome = run("invert", f"clip={clip}", "out=o")
    assert outcome.code == 1 and "add rig=NAME, or bundle=DIR" in outcome.text


def test_a_rig_without_gradients_goes_through_its_surrogate_and_judges_itself(run, clip, tmp_path):
    options = ("rig=black_box", "mesh_space.samples=60", "mesh_space.residual_mm=0.5", "data.black_box_poses=40")
    trained = run("train", *options)
    assert trained.code == 0, trained.text
    outcome = run("invert", f"bundle={tmp_path / 'run'}", "rig=black_box", TOY[1], f"clip={clip}", "out=o", *PLAIN, "refine=5")
    assert outcome.code == 0, outcome.text
    assert "Evaluated by the true rig, black box" in outcome.text and len(rows(tmp_path / "o/frames.csv")) == 20
