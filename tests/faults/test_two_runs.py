"""Two processes on one folder: one works, the others are told; a lock goes with its process, however that ends."""

import shutil

import pytest

from tests.faults.contents import contents
from tests.faults.tally import fault
from tests.faults.works import QUICK, solving, training

KIND, HOW = "two commands on one folder", "one works, the others are refused by a lock that the kernel holds"
REFUSALS = ("in use by another process", "has just begun there", "holds a run already", "it is there already")


def in_use(folder) -> bool:
    return (folder / "run/checkpoints/last.ckpt").exists()


def test_a_second_run_is_refused_while_the_first_goes_on(commands, whole, tmp_path):
    work = training(*QUICK)
    expected = whole(work).contents
    here = work.prepare(tmp_path / "both")
    first = commands.start(work.name, work.arguments, here)
    while not in_use(here):
        assert not first.ends_within(0.02), first.said
    with fault(KIND, HOW):
        second = commands.run(work.name, [*work.arguments, "resume=true"], here)
        assert first.code is None and second.code == 1, second.said
        assert f"in use by another process (process {first.process} on " in second.said and "Traceback" not in second.said
    first.kill()
    first.wait()
    with fault(KIND, HOW):  # the kernel took the lock back
        third = commands.run(work.name, [*work.arguments, "resume=true"], here)
        assert third.code == 0, third.said
        assert contents(here) == expected


@pytest.mark.parametrize("rounds", [1, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["train", "invert"])
def test_of_those_that_start_at_once_one_works(commands, whole, tmp_path, clip, name, rounds):
    work = training(*QUICK) if name == "train" else solving(clip)
    expected = whole(work).contents
    for number in range(rounds):
        here = work.prepare(tmp_path / f"round {number}")
        started = [commands.start(work.name, work.arguments, here) for _ in range(4)]
        with fault(KIND, HOW, 3):
            codes = [running.wait() for running in started]
            assert sorted(codes) == [0, 1, 1, 1], [running.said for running in started]
            for running in started:
                assert running.code == 0 or any(refusal in running.said for refusal in REFUSALS), running.said
            assert contents(here) == expected
        shutil.rmtree(here)
