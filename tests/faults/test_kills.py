"""SIGKILL at random moments; the same command again; what it leaves is what an unbroken run leaves, byte by byte."""

import random
import shutil
from pathlib import Path

import pytest

from tests.faults.contents import contents
from tests.faults.processes import Commands
from tests.faults.tally import fault
from tests.faults.works import Work, exporting, solving, training

HOW = "the same command again; every file compared byte by byte"


def strike(commands: Commands, work: Work, folder: Path, count: int, kind: str) -> None:
    """Kill the command so often, each time in a fresh folder, now and then once more as it goes on, and compare what it leaves."""
    expected, seconds = work.unbroken(commands, folder)
    draw, kills, trial = random.Random(0), 0, 0
    while kills < count:
        trial += 1
        here, struck = work.prepare(folder / f"trial {trial}"), 0
        moments = [draw.uniform(0, seconds) for _ in range(draw.choice((1, 1, 2)))][: count - kills]
        for moment in moments:
            if not work.done(here):
                done = commands.run(work.name, [*work.arguments, *(work.again if struck else [])], here, moment)
                assert done.code in (0, -9), done.said
                struck += done.code == -9
        kills += struck
        with fault(kind, HOW, struck):
            if not work.done(here):
                done = commands.run(work.name, [*work.arguments, *work.again], here)
                assert done.code == 0, f"killed after {moments} s: {done.said}"
            assert contents(here) == expected, f"killed after {moments} s"
        shutil.rmtree(here)


@pytest.mark.parametrize("count", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_training(commands, tmp_path, count):
    strike(commands, training(), tmp_path, count, "SIGKILL while training")


@pytest.mark.parametrize("count", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_solving(commands, tmp_path, clip, count):
    strike(commands, solving(clip), tmp_path, count, "SIGKILL while solving a clip and writing its curves")


@pytest.mark.slow
def test_export(commands, tmp_path, trained):
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    strike(commands, exporting(trained), tmp_path, 100, "SIGKILL while exporting ONNX")
