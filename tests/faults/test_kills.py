"""SIGKILL at random moments; the same command again; what it leaves is what an unbroken run leaves, byte by byte."""

import random
import shutil
from pathlib import Path

import pytest

from tests.faults.contents import contents
from tests.faults.processes import Commands
from tests.faults.tally import fault
from tests.faults.works import QUICK, Whole, Work, exporting, sampling, solving, training

HOW = "the same command again; every file compared byte by byte"
WHILE_TRAINING, WHILE_SOLVING = "SIGKILL while training", "SIGKILL while solving a clip and writing its curves"


def strike(commands: Commands, work: Work, whole: Whole, folder: Path, count: int, kind: str) -> None:
    """Kill the command so often, each time in a fresh folder, now and then twice, and compare what it leaves in the end."""
    draw, kills, trial, seconds = random.Random(0), 0, 0, whole.seconds
    while kills < count:
        trial += 1
        here, struck = work.prepare(folder / f"trial {trial}"), 0
        moments = [draw.uniform(0, seconds) for _ in range(draw.choice((1, 1, 2)))][: count - kills]
        for moment in moments:
            if not work.done(here):
                done = commands.run(work.name, [*work.arguments, *(work.again if struck else [])], here, moment)
                assert done.code in (0, -9), done.said
                struck += done.code == -9
                seconds = seconds if struck else min(seconds, done.seconds)
        kills += struck
        with fault(kind, HOW, struck):
            if not work.done(here):
                done = commands.run(work.name, [*work.arguments, *work.again], here)
                assert done.code == 0, f"killed after {moments} s: {done.said}"
            assert contents(here) == whole.contents, f"killed after {moments} s"
        print(f"{kind}: {kills} of {count}", flush=True)
        shutil.rmtree(here)


def test_training(commands, whole, tmp_path):
    work = training(*QUICK)
    strike(commands, work, whole(work), tmp_path, 2, WHILE_TRAINING)


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "count"), [(QUICK, 90), ((), 10)])
def test_training_a_hundred_times(commands, whole, tmp_path, arguments, count):
    work = training(*arguments)
    strike(commands, work, whole(work), tmp_path, count, WHILE_TRAINING)


@pytest.mark.parametrize("count", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_solving(commands, whole, tmp_path, clip, count):
    work = solving(clip)
    strike(commands, work, whole(work), tmp_path, count, WHILE_SOLVING)


@pytest.mark.slow
def test_exporting(commands, whole, tmp_path, trained):
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    work = exporting(trained)
    strike(commands, work, whole(work), tmp_path, 100, "SIGKILL while exporting ONNX")


@pytest.mark.parametrize("count", [2, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_sampling(commands, whole, tmp_path, jobs, count):
    work = sampling(jobs)
    strike(commands, work, whole(work), tmp_path, count // jobs, f"SIGKILL while sampling into a store, jobs={jobs}")
