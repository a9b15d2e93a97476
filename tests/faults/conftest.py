"""The tally at the end, and what the tests share."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import SMALL
from tests.faults.processes import Commands
from tests.faults.tally import ROWS, table
from tests.faults.works import Whole, Work
from tests.support.clips import performance, write_npz
from tests.support.toys import ToyRig


@pytest.fixture(scope="session")
def commands() -> Iterator[Commands]:
    with Commands() as started:
        yield started


@pytest.fixture(scope="session")
def clip(tmp_path_factory) -> Path:
    """A folder with take.npz, a clip of the toy."""
    folder, rig = tmp_path_factory.mktemp("clip"), ToyRig()
    write_npz(folder / "take.npz", performance(rig, 60), rig.faces.numpy())
    return folder


@pytest.fixture(scope="session")
def trained(commands, tmp_path_factory) -> Path:
    """A folder with run/, an inverse of the toy."""
    folder = tmp_path_factory.mktemp("trained")
    done = commands.run("train", [*SMALL, "model/network=direct", "hydra.run.dir=run"], folder)
    assert done.code == 0, done.said
    return folder


@pytest.fixture(scope="session")
def whole(commands, tmp_path_factory) -> Callable[[Work], Whole]:
    """What a command leaves when nothing happens: asked for often, found out once."""
    kept: dict[str, Whole] = {}

    def whole_of(work: Work) -> Whole:
        key = str(work.arguments)
        if key not in kept:
            kept[key] = work.unbroken(commands, tmp_path_factory.mktemp("whole"))
        return kept[key]

    return whole_of


def pytest_terminal_summary(terminalreporter: Any) -> None:
    if ROWS:
        terminalreporter.section("faults")
        for line in table():
            terminalreporter.write_line(line)
