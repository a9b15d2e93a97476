"""A clock that jumps by years while a command runs and between its starts: the same folder, the same result.

The clock is libfaketime's (pip install 'riginv[faults]', or apt install faketime): every process sees
it, the kernel's own files do not.
"""

import importlib.util
import os
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.contents import contents
from tests.faults.processes import Commands, Running
from tests.faults.tally import fault
from tests.faults.works import QUICK, solving, training

KIND, HOW = "clock that jumps by years", "time is only told by it, never measured; every file compared byte by byte"
YEARS = 365 * 24 * 3600


def library() -> Path | None:
    """libfaketime, from its Python package or from the system."""
    package = importlib.util.find_spec("libfaketime")
    places = [*Path(package.origin).parent.rglob("libfaketime*.so.1")] if package else []
    places += Path("/usr/lib").glob("*/faketime/libfaketime.so.1")
    return next(iter(places), None)


class Clock:
    """The time that commands see, as an offset from the true one.

    Args:
        file: that libfaketime looks at whenever it is asked for the time.
    """

    def __init__(self, file: Path) -> None:
        self.file, self.draw = file, random.Random(0)
        self.set(0)

    def set(self, seconds: int) -> None:
        beside = self.file.with_suffix(".new")
        beside.write_text(f"{seconds:+d}\n")
        os.replace(beside, self.file)

    def jump(self) -> None:
        self.set(self.draw.randint(-20 * YEARS, 20 * YEARS))

    def jump_until_end(self, running: Running) -> int:
        """Jump about until a command has ended; how often."""
        jumps = 0
        while not running.ends_within(0.3):
            self.jump()
            jumps += 1
        return jumps


@pytest.fixture(scope="module")
def clock(tmp_path_factory) -> Clock:
    return Clock(tmp_path_factory.mktemp("clock") / "offset")


@pytest.fixture(scope="module")
def clocked(clock) -> Iterator[Commands]:
    """Commands that see the clock."""
    found = library()
    if found is None:
        pytest.skip("libfaketime is not here: pip install 'riginv[faults]'")
    environment = {"LD_PRELOAD": str(found), "FAKETIME_TIMESTAMP_FILE": str(clock.file), "FAKETIME_NO_CACHE": "1"}
    with Commands({**environment, "FAKETIME_DONT_FAKE_MONOTONIC": "1"}) as started:
        yield started


@pytest.mark.slow
@pytest.mark.parametrize("name", ["train", "invert"])
def test_jumps_while_a_command_runs(clocked, clock, clip, tmp_path, name):
    work = training(*QUICK) if name == "train" else solving(clip)
    clock.set(0)
    expected = work.unbroken(clocked, tmp_path / "whole").contents
    for number in range(2):
        here = work.prepare(tmp_path / f"jumping {number}")
        running = clocked.start(work.name, work.arguments, here)
        jumps = clock.jump_until_end(running)
        with fault(KIND, HOW, jumps):
            assert running.code == 0, running.said
            assert contents(here) == expected


@pytest.mark.slow
def test_a_run_named_by_a_wrong_clock_is_found_again(clocked, clock, tmp_path):
    work = training(*QUICK)
    clock.set(0)
    expected, seconds, _ = work.unbroken(clocked, tmp_path / "whole")
    arguments = [argument for argument in work.arguments if not argument.startswith("hydra.run.dir")]
    for number, years in enumerate((-30, 8)):
        here = work.prepare(tmp_path / f"named {number}")
        clock.set(0)
        clocked.run(work.name, arguments, here, seconds * 0.7)
        (begun,) = here.glob("runs/*/*")
        with fault(KIND, HOW):
            clock.set(years * YEARS)
            done = clocked.run(work.name, [*arguments, "resume=true"], here)
            assert done.code == 0, done.said
            assert list(here.glob("runs/*/*")) == [begun]
            assert {f"run/{name}": digest for name, digest in contents(begun).items()} == expected


@pytest.mark.slow
def test_two_runs_in_the_same_second_do_not_overwrite_each_other(clocked, clock, tmp_path):
    work = training(*QUICK)
    arguments = [argument for argument in work.arguments if not argument.startswith("hydra.run.dir")]
    here = work.prepare(tmp_path / "here")
    clock.file.write_text("@2026-01-01 00:00:00\n")
    running = clocked.run(work.name, arguments, here)
    before = contents(here)
    assert running.code == 0, running.said
    clock.file.write_text("@2026-01-01 00:00:00\n")
    with fault(KIND, HOW):
        running = clocked.run(work.name, arguments, here)
        folders = list(here.glob("runs/*/*"))
        assert (running.code == 1 and "holds a run already" in running.said) or len(folders) == 2, running.said
        assert before.items() <= contents(here).items()
