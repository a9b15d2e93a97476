"""A run that is killed at any moment and started again ends in the weights of an unbroken one, bit for bit."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from tests.conftest import ROOT, SMALL

STEPS = 400  # so many that a run is far from its end when it is killed, on a busy machine too
LONGER = [
    f"trainer.max_steps={STEPS}",
    "data.steps_per_epoch=40",
    "checkpoint.every_n_steps=7",
    "evaluation.validation_poses=2",
]


def start(folder: Path, *more: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "riginv.train", *SMALL, *LONGER, f"hydra.run.dir={folder}", *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        command,
        cwd=folder.parent,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=restore_sigint,
    )


def restore_sigint() -> None:
    """What a shell runs in the background ignores SIGINT, and so would all that it starts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def saved_step(folder: Path) -> int:
    path = folder / "checkpoints/last.ckpt"
    return torch.load(path, weights_only=True)["global_step"] if path.exists() else 0


def kill_after(process: subprocess.Popen, folder: Path, step: int, how: signal.Signals) -> str:
    """Let a run get past a step, then kill it."""
    while process.poll() is None and saved_step(folder) <= step:
        time.sleep(0.02)
    assert process.poll() is None, "the run ended before it could be killed"
    process.send_signal(how)
    return process.communicate(timeout=60)[0]


def same_weights(one: Path, other: Path) -> bool:
    a, b = (load_file(folder / "bundle/weights.safetensors") for folder in (one, other))
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


@pytest.mark.slow
def test_killed_within_an_epoch_by_either_signal_a_run_ends_the_same(tmp_path, run):
    whole = run("train", *LONGER, folder="whole")
    assert whole.code == 0, whole.text
    broken = tmp_path / "broken"
    kill_after(start(broken), broken, step=7, how=signal.SIGKILL)
    said = kill_after(start(broken, "resume=true"), broken, step=saved_step(broken) + 14, how=signal.SIGINT)
    assert "resume=true" in said and "Traceback" not in said
    assert 0 < saved_step(broken) < STEPS
    resumed = run("train", *LONGER, "resume=true", folder="broken")
    assert resumed.code == 0, resumed.text
    assert same_weights(whole.folder, broken)
    assert {key: value for key, value in resumed.metrics.items() if key != "train/seconds"} == {
        key: value for key, value in whole.metrics.items() if key != "train/seconds"
    }


def test_killed_before_the_first_checkpoint_a_run_starts_over(tmp_path, run):
    whole = run("train", folder="whole")
    broken = tmp_path / "broken"
    process = start(broken)
    while not (broken / "config.yaml").exists():
        time.sleep(0.01)
    process.kill()
    process.wait()
    if not (broken / "checkpoints/last.ckpt").exists():
        (broken / "config.yaml").write_text((whole.folder / "config.yaml").read_text())
        assert run("train", "resume=true", folder="broken").code == 0
        assert same_weights(whole.folder, broken)


def test_the_plateau_schedule_is_resumed_too(run, tmp_path):
    plateau = ["model/schedule=plateau", "model.schedule.patience=0", "trainer.max_steps=60", "data.steps_per_epoch=8"]
    plateau += ["model.optimizer.lr=0.05"]
    whole = run("train", *plateau, folder="whole")
    stopped = run("train", *plateau, "checkpoint.every_n_steps=1000", folder="half")
    assert whole.code == stopped.code == 0
    assert same_weights(whole.folder, stopped.folder)  # how often is saved changes nothing


@pytest.mark.slow
def test_killed_at_twenty_random_moments_a_run_ends_the_same(tmp_path, run):
    longer = ["trainer.max_steps=3000", "data.steps_per_epoch=400"]
    whole = run("train", *LONGER, *longer, folder="whole")
    broken, kills, draw = tmp_path / "broken", 0, random.Random(0)
    for _attempt in range(20):
        process = start(broken, *longer, *(["resume=true"] if broken.exists() else []))
        try:
            process.wait(timeout=draw.uniform(6, 14))
            break
        except subprocess.TimeoutExpired:
            process.send_signal(draw.choice([signal.SIGKILL, signal.SIGINT]))
            process.communicate(timeout=60)
            kills += 1
    run("train", *LONGER, *longer, "resume=true", folder="broken")
    assert kills >= 3 and same_weights(whole.folder, broken)
