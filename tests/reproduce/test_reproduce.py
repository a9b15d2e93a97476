"""python -m riginv.reproduce: the whole graph on a toy, and how it goes on after whatever happens to it."""

import contextlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from PIL import Image
from safetensors.torch import load_file

from riginv.config.messages import CONFIGS
from riginv.config.typed import to_plain, to_typed
from riginv.launch.command import command
from riginv.reproduce.__main__ import reproduce
from riginv.reproduce.plan import Plan, expected_steps, is_open_ended
from riginv.reproduce.sets import CaptureSource, Subset, middle_clip
from riginv.reproduce.settings import ReproduceConfig
from riginv.reproduce.steps import DONE
from riginv.runs.run_folder import register_folder_resolvers
from riginv.training.config import TrainConfig
from tests.config.test_bad_input import refused
from tests.conftest import ROOT
from tests.support.toys import ToyRig

TINY = [
    "rig=toy",
    f"--config-dir={ROOT / 'tests/conf'}",
    "true_rig=same",
    "rig@body=toy",
    "jobs=1",
    "budget.samples=200",
    "budget.meshes=12",
    "budget.frames=20",
    "budget.seeds=[0,1,2]",
    "budget.settings=['trainer=cpu','model.network.hidden=[32]','data.steps_per_epoch=6','data.batch_size=8',"
    "'evaluation.validation_poses=4','pictures.every_n_validations=null','pictures.final=false','trainer.log_every_n_steps=1']",
    *(f"budget.networks.{name}.steps=12" for name in ("surrogate", "inverse", "holden", "best", "body")),
    "budget.others=[blendshape_ridge,quadratic]",
    "budget.optimum={starts: 2, key_starts: 1, steps: 6, descent_steps: 10}",
]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
pytestmark = pytest.mark.filterwarnings("ignore:.*in eval mode at the start")  # the rig, which steps in one process share
FEW = ["budget.seeds=[0]", "budget.variants=null", "rig@body=same", "true_rig=blender_if_here"]


def start(folder: Path, *more: str) -> subprocess.Popen:
    arguments = [sys.executable, "-m", "riginv.reproduce", *TINY, f"hydra.run.dir={folder}", *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        arguments, cwd=folder.parent, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def finished(process: subprocess.Popen) -> str:
    text = process.communicate(timeout=240)[0]
    assert process.returncode == 0, text
    return text


def tables(folder: Path) -> dict:
    found = json.loads((folder / "tables.json").read_text())
    return {name: found[name] for name in ("table1", "table2", "table3", "orderings", "claims")}


def step(folder: Path, name: str) -> Path:
    return next(path for path in (folder / "steps").iterdir() if path.name.rpartition("-")[0] == name)


def reproduced_here(folder: Path, *more: str) -> str:
    """What the command says, run within this process, which saves its imports."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        patched.setattr(sys, "argv", ["riginv.reproduce", *TINY, f"hydra.run.dir={folder}", *more])
        patched.chdir(folder.parent)
        GlobalHydra.instance().clear()
        command("reproduce")(reproduce)()
    return said.getvalue()


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder in which the whole graph has been run, and what the command said there."""
    folder = tmp_path_factory.mktemp("reproduced") / "run"
    text = reproduced_here(folder)
    (folder / "said.txt").write_text(text)
    return folder


def test_every_row_of_the_three_tables_is_there(made):
    found = tables(made)
    assert [row["row"] for row in found["table1"]] == ["programmatic", "trained"]
    rows = [(row["set"], row["row"]) for row in found["table2"]]
    methods = ["inverse", "trained", "holden", "best", "optimum", "neutral"]
    assert rows == [(name, row) for name in ("random_combinations", "simulated_performance", "rig_poses") for row in methods]
    assert [row["row"] for row in found["table3"]][:5] == ["inverse", "trained", "direct", "direct_trained", "clip"]
    for row in (*found["table1"], *found["table2"], *found["table3"]):
        learned = row["row"] in ("trained", "inverse", "holden", "best", "direct_trained")
        keys = [key for key in ("mean_vertex_error_mm", "max_vertex_error_mm", "roughness") if key in row]
        for key in keys:
            values = torch.tensor(row[f"{key}_values"], dtype=torch.float64)
            assert len(values) == (3 if learned else 1) and row["seeds"] == ([0, 1, 2] if learned else [])
            assert row[key] == pytest.approx(float(values.mean()))
            assert (row[f"{key}_spread"] is None) != learned
            if learned:
                assert row[f"{key}_spread"] == pytest.approx(float(values.std()))
    paper = {(row["set"], row["row"]): row["paper_mean_vertex_error_mm"] for row in found["table2"]}
    assert paper["random_combinations", "holden"] == 9.2 and paper["simulated_performance", "inverse"] == 4.8


def test_figures_are_what_the_rig_makes_of_the_controls_that_were_found(made):
    rig = ToyRig()
    controls = load_file(step(made, "invert-trained-seed1") / "controls.safetensors")["clip"]
    clip = middle_clip(rig, CaptureSource(), 20)
    assert len(controls) == 20
    rows = torch.linspace(0, 19, 12).round().long()
    distances = (rig(controls[rows]) - Subset(clip, rows).vertices(0, 12)).square().sum(dim=2).sqrt()
    second = controls[2:] - 2 * controls[1:-1] + controls[:-2]
    found = next(row for row in tables(made)["table3"] if row["row"] == "trained")
    assert found["mean_vertex_error_mm_values"][1] == pytest.approx(float(distances.mean()), rel=1e-4)
    assert found["max_vertex_error_mm_values"][1] == pytest.approx(float(distances.max()), rel=1e-4)
    assert found["roughness_values"][1] == pytest.approx(float((second**2).mean()), rel=1e-4)


def test_a_step_that_is_deleted_comes_out_the_same(made, tmp_path):
    """One of each kind, by another process; and one whose mark is damaged, and one of another version."""
    folder = tmp_path / "run"
    shutil.copytree(made, folder)
    gone = ["sample", "surrogate-seed1", "trained-seed1", "holden-seed0", "best-seed2", "invert-direct", "evaluate-optimum"]
    gone += ["evaluate-surrogate-seed0", "lipschitz-noisy", "variant-batch_normalised", "figure-maps"]
    for name in gone:
        shutil.rmtree(step(folder, name))
    (step(folder, "evaluate-clip") / DONE).write_text('{"format": 1, "sec')
    older = step(folder, "evaluate-neutral")
    older.rename(older.with_name("evaluate-neutral-0123456789ab"))
    text = finished(start(folder))
    assert "1 kept steps are of another version" in text
    steps = len(list((folder / "steps").iterdir())) - 1
    assert f"{steps - len(gone) - 2} of {steps} steps are kept from before" in text
    assert tables(folder) == tables(made)


def test_the_report_is_one_file_that_says_who_evaluated(made):
    page = (made / "report.html").read_text()
    assert "The programmatic rig evaluated itself" in page and page.index("evaluated itself") < page.index("Table 1")
    assert not re.search(r"(src|href)=[\"'](?!data:)", page) and "http" not in page.split("<body>")[0]
    assert page.count("data:image/png;base64,") == 6
    for word in ("A reduced budget", "seed", "torch", "processor", "samples: 200"):
        assert word in page
    assert page.count("A reduced budget") >= 3  # on every table
    assert (made / "tables.md").read_text().count("A reduced budget") == 3
    said = (made / "said.txt").read_text()
    assert "evaluates itself" in said and re.search(r"\[\d+/\d+\] .*left", said)


def test_a_browser_shows_the_report(made, tmp_path):
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        pytest.skip(f"no browser here: none of {', '.join(BROWSERS)}")
    asked, page, picture = "document.title", tmp_path / "report.html", tmp_path / "report.png"
    widths = "[...document.images].map(image => image.naturalWidth).join()"
    broad = "document.documentElement.scrollWidth > window.innerWidth"
    script = f"<script>window.onload = () => {{ {asked} = {widths} + ' ' + ({broad}) }}</script></body>"
    page.write_text((made / "report.html").read_text().replace("</body>", script))
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--proxy-server=127.0.0.1:9", "--window-size=1100,1600"]
    flags += [f"--user-data-dir={tmp_path / 'profile'}"]
    shown = subprocess.run([browser, *flags, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=120).stdout
    title = re.search(r"<title>([\d,]+) (true|false)</title>", shown)
    assert title and title[2] == "false", shown[:500]  # nothing is wider than the window
    assert len(title[1].split(",")) == 6 and min(map(int, title[1].split(","))) > 300
    assert shown.count("<tr") >= len([row for rows in tables(made).values() for row in rows])
    subprocess.run([browser, *flags, f"--screenshot={picture}", page.as_uri()], capture_output=True, timeout=120)
    pixels = np.asarray(Image.open(picture).convert("L"))
    assert pixels.shape == (1600, 1100) and pixels.std() > 10


def test_a_claim_has_a_verdict_and_its_figures(made):
    found = tables(made)
    assert len(found["claims"]) == 8
    for claim in found["claims"]:
        assert claim["verdict"] in ("held", "not held", "depends") and re.search(r"\d", claim["figures"]), claim
    rows = {(row["set"], row["row"]): row["mean_vertex_error_mm"] for row in found["table2"]}
    ours = [rows["random_combinations", row] for row in ("inverse", "trained", "holden")]
    assert found["orderings"][0]["holds"] == (ours[0] <= ours[1] < ours[2])


def test_a_killed_run_loses_the_step_in_progress_alone(tmp_path):
    """And, as there is no toy in Blender, the rig evaluates itself, which is said first and at the top."""
    folder = tmp_path / "run"
    process = start(folder, *FEW)
    while process.poll() is None and len(list(folder.glob(f"steps/*/{DONE}"))) < 9:
        time.sleep(0.02)
    assert process.poll() is None, "the run ended before it could be killed"
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=60)
    done = {path.parent.name: path.stat().st_mtime_ns for path in folder.glob(f"steps/*/{DONE}")}
    text = reproduced_here(folder, *FEW)
    assert f"{len(done)} of " in text and "kept from before" in text
    assert all((folder / "steps" / name / DONE).stat().st_mtime_ns == when for name, when in done.items())
    assert not list(folder.rglob(".*.part"))
    said = " ".join(text.split())
    assert re.search(r"^The programmatic rig evaluates itself: [^.]*Blender", said)
    page = (folder / "report.html").read_text()
    assert re.search(r"evaluated itself</b>[^.]*Blender", page) and page.index("evaluated itself") < page.index("Table 1")
    assert {row["verdict"] for row in tables(folder)["claims"]} >= {"not tested"}


@pytest.mark.slow
def test_figures_do_not_depend_on_how_many_steps_run_beside_each_other(made, tmp_path):
    finished(start(tmp_path / "run", "jobs=2"))
    assert tables(tmp_path / "run") == tables(made)


def test_the_papers_budget_is_its_protocol_and_its_time_is_estimated():
    register_folder_resolvers()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        plain = OmegaConf.to_container(compose("reproduce", ["budget=paper"]), resolve=True)
        plan = Plan(to_typed(plain, ReproduceConfig), None, None, 1)
    steps = {step.name: step for step in plan.steps}
    assert steps["sample"].task.count == 10_000
    assert steps["surrogate-seed2"].task.training.data.stored_poses == 90_000
    training = steps["trained-seed1"].task.training
    inverse = to_plain(training)
    assert to_typed(inverse, TrainConfig) == training
    assert inverse["data"] == {
        "batch_size": 64,
        "steps_per_epoch": 10_000,
        "stored_poses": None,
        "store": None,
        "black_box_poses": 8000,
    }
    assert (inverse["model"]["optimizer"]["lr"], inverse["stop_below_lr"]) == (1e-4, 1e-6)
    assert inverse["model"]["network"]["control_map"] == "range_tanh" and inverse["seed"] == 1
    assert expected_steps(training) == 7 * 21 * 10_000  # seven halvings from 1e-4 to below 1e-6, 21 epochs each at the least
    assert [name for name, step in steps.items() if is_open_ended(step)][:2] == ["surrogate-seed0", "surrogate-seed1"]
    plan.expect({"surrogate": 0.001, "inverse": 0.003, "trained": 0.004, "holden": 0.002, "best": 0.005})
    expected = {step.name: step.expected_s for step in plan.steps}
    assert expected["inverse-seed0"] == pytest.approx(1.47e6 * 0.003, rel=0.01)
    assert sum(expected.values()) > 20 * 3600


def test_mistakes_are_told_of_before_anything_starts(run, tmp_path):
    folder = tmp_path / "run"
    for arguments, words in (
        (["capture=none.csv"], ["none.csv", "no such file"]),
        (["true_rig=blender", "true_rig.interpreter=none-such"], ["none-such", "no such program"]),
        (["budget.seeds=[0,0]"], ["budget.seeds", "different whole numbers"]),
        (["budget.samples=10000000000000"], ["GB are free", "hydra.run.dir"]),
        (["budget.networks.best.settings=[model=nothing]"], ["model=nothing"]),
        (["budget.frames=0"], ["budget.frames is 0"]),
        (["rig=black_box"], ["black box", "gradients"]),
    ):
        outcome = run("reproduce", *TINY, *arguments)
        refused(outcome, *words)
        assert not (folder / "steps").exists(), arguments
    (tmp_path / "file").write_text("")
    refused(run("reproduce", *TINY, folder="file/run"), "file/run", "cannot be written")


def test_a_clip_whose_curves_the_rig_lacks_is_refused_at_the_start(run, tmp_path):
    clip = tmp_path / "take.csv"
    rows = [f"10:00:00:0{frame}.000,3,0.1,0.2,0.{frame}" for frame in range(5)]
    clip.write_text("\n".join(["Timecode,BlendShapeCount,JawOpen,MouthFunnel,NoseFlare", *rows]) + "\n")
    refused(run("reproduce", *TINY, "+rig.arkit=true", f"capture={clip}"), "NoseFlare")
