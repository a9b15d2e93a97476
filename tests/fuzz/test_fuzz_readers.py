"""Damaged files of every kind end in one sentence, or are read all the same; `python -m tests.fuzz` does it at length."""

import pytest

from tests.fuzz.readers import IN_PROCESSES, READERS
from tests.fuzz.tally import survive

QUICK, MANY = 25, 3000
NEVER_REFUSED = ("cache", "kept steps", "config folder")  # made anew; of the last Hydra says what cannot be read


def cases_of(name: str, most: int) -> int:
    return max(most // 50, 2) if name in IN_PROCESSES else most


@pytest.mark.parametrize("name", READERS)
def test_damage_ends_in_a_sentence(name, tmp_path, own_cache, capsys):
    if "usd" in name:
        pytest.importorskip("pxr", reason="usd-core is not installed")
    tally = survive(name, READERS[name](tmp_path), cases_of(name, QUICK), seed=1)
    assert not tally.crashes, tally.crashes[0]
    assert (tally.refused > 0) == (name not in NEVER_REFUSED)  # the damage is real


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_much_more_damage_ends_in_a_sentence(name, tmp_path, own_cache, capsys):
    if "usd" in name:
        pytest.importorskip("pxr", reason="usd-core is not installed")
    tally = survive(name, READERS[name](tmp_path), cases_of(name, MANY), seed=2)
    assert not tally.crashes, tally.crashes[0]
