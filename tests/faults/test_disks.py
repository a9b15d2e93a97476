"""Full disks and folders that cannot be written: a sentence, nothing half-written, and the same result once there is room."""

import importlib.util
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.contents import contents
from tests.faults.processes import Commands
from tests.faults.tally import fault
from tests.faults.works import QUICK, Whole, Work, exporting, sampling, solving, training

LARGE = "256m"
FULL = ("the disk is full", "No space left on device")


@pytest.fixture
def disks(commands) -> Iterator[Commands]:
    """Commands with mounts of their own."""
    if commands.namespace is None:
        pytest.skip("no mounts of one's own here: unshare --mount is not allowed")
    return commands


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def fill(commands: Commands, work: Work, whole: Whole, folder: Path, count: int, kind: str) -> None:
    """Let a disk fill up under a command, at sizes from nearly nothing to nearly enough, make it larger, and go on."""
    needed, filled = size(whole.folder) * 1.2, 0
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
                assert "Traceback" not in done.said and any(words in done.said for words in FULL), done.said
                commands.mount("-o", f"remount,size={LARGE}", str(here))
                done = commands.run(work.name, [*work.arguments, *work.again], here)
            assert done.code == 0, done.said
            assert contents(commands.seen(here)) == whole.contents, f"a disk of {room} bytes"
        print(f"{kind}: {filled} of {count}", flush=True)


@pytest.mark.parametrize("count", [1, pytest.param(15, marks=pytest.mark.slow)])
def test_full_while_training(disks, whole, tmp_path, count):
    work = training(*QUICK)
    fill(disks, work, whole(work), tmp_path, count, "full disk while training")


@pytest.mark.parametrize("count", [1, pytest.param(15, marks=pytest.mark.slow)])
def test_full_while_solving(disks, whole, tmp_path, clip, count):
    work = solving(clip)
    fill(disks, work, whole(work), tmp_path, count, "full disk while solving")


@pytest.mark.parametrize("count", [1, pytest.param(15, marks=pytest.mark.slow)])
def test_full_while_sampling(disks, whole, tmp_path, count):
    work = sampling()
    fill(disks, work, whole(work), tmp_path, count, "full disk while sampling into a store")


@pytest.mark.slow
def test_full_while_exporting(disks, whole, tmp_path, trained):
    pytest.importorskip("onnxscript")
    pytest.importorskip("onnxruntime")
    work = exporting(trained)
    fill(disks, work, whole(work), tmp_path, 10, "full disk while exporting")


def test_a_folder_that_cannot_be_written(disks, tmp_path, clip, trained):
    works = {"train": training(*QUICK), "sample": sampling(), "solve": solving(clip)}
    if importlib.util.find_spec("onnxruntime"):
        works["export"] = exporting(trained)
    for name, work in works.items():
        here = work.prepare(tmp_path / name)
        before = contents(here)
        disks.mount("--bind", str(here), str(here))
        disks.mount("-o", "remount,ro,bind", str(here))
        with fault("read-only folder", "one sentence before any work; nothing is touched"):
            done = disks.run(work.name, work.arguments, here)
            assert done.code == 1 and "Traceback" not in done.said and "cannot be written" in done.said, done.said
            assert "Read-only file system" in done.said and contents(here) == before
