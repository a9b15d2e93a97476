"""Full disks and folders that cannot be written: a sentence, nothing half-written, and the same result once there is room."""

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.contents import contents
from tests.faults.processes import Commands
from tests.faults.tally import fault
from tests.faults.works import Work, exporting, solving, training

LARGE = "256m"


@pytest.fixture
def disks(commands) -> Iterator[Commands]:
    """Commands with mounts of their own."""
    if commands.namespace is None:
        pytest.skip("no mounts of one's own here: unshare --mount is not allowed")
    return commands


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def fill(commands: Commands, work: Work, folder: Path, count: int, kind: str) -> None:
    """Let a disk fill up under a command, at sizes from nearly nothing to nearly enough, make it larger, and go on."""
    expected, _ = work.unbroken(commands, folder)
    needed, filled = size(folder / "whole") * 1.2, 0
    given = size(work.needs) if work.needs else 0
    draw, trial = random.Random(0), 0
    while filled < count:
        trial += 1
        here = folder / f"disk {trial}"
        here.mkdir()
        room = int(given + 8192 + draw.random() * (needed - given))
        commands.mount("-t", "tmpfs", "-o", f"size={room}", "none", str(here))
        work.prepare(commands.seen(here))
        done = commands.run(work.name, work.arguments, here)
        full = done.code != 0
        filled += full
        with fault(kind, "one sentence; with more room the same command goes on", full):
            assert done.code in (0, 1)
            if full:
                assert "Traceback" not in done.said and "the disk is full" in done.said, done.said
                commands.mount("-o", f"remount,size={LARGE}", str(here))
                done = commands.run(work.name, [*work.arguments, *work.again], here)
            assert done.code == 0, done.said
            assert contents(commands.seen(here)) == expected, f"a disk of {room} bytes"


@pytest.mark.parametrize("count", [1, pytest.param(40, marks=pytest.mark.slow)])
def test_full_while_training(disks, tmp_path, count):
    fill(disks, training(), tmp_path, count, "full disk while training")


@pytest.mark.parametrize("count", [1, pytest.param(40, marks=pytest.mark.slow)])
def test_full_while_solving(disks, tmp_path, clip, count):
    fill(disks, solving(clip), tmp_path, count, "full disk while solving")


@pytest.mark.slow
def test_full_while_exporting(disks, tmp_path, trained):
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    fill(disks, exporting(trained), tmp_path, 10, "full disk while exporting")


def test_a_folder_that_cannot_be_written(disks, tmp_path, clip, trained):
    for name, work in {"train": training(), "solve": solving(clip), "export": exporting(trained)}.items():
        here = work.prepare(tmp_path / name)
        before = contents(here)
        disks.mount("--bind", str(here), str(here))
        disks.mount("-o", "remount,ro,bind", str(here))
        with fault("read-only folder", "one sentence before any work; nothing is touched"):
            done = disks.run(work.name, work.arguments, here)
            assert done.code == 1 and "Traceback" not in done.said and "cannot be written" in done.said, done.said
            assert "Read-only file system" in done.said and contents(here) == before
