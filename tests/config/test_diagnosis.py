"""A value of another kind than where it stands is named, where nothing else knows why a command failed."""

import pytest

from riginv.config.diagnosis import wrong_kind
from tests.config.test_bad_input import refused

USUAL = {"seed": 0, "name": "x", "on": True, "file": None, "hidden": [8, 8], "data": {"size": 4}, "most": "???"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": "five"}, "seed is 'five', expected a number"),
        ({"seed": True}, "seed is True, expected a number"),
        ({"seed": float("nan")}, "seed is nan, expected a number"),
        ({"on": 1}, "on is 1, expected true or false"),
        ({"name": ["x"]}, "name is ['x'], expected text"),
        ({"hidden": 8}, "hidden is 8, expected a list"),
        ({"hidden": [8, "x"]}, "hidden[1] is 'x', expected a number"),
        ({"file": {"a": 1}}, "file is {'a': 1}, expected null, a name or a number"),
        ({"data": 3}, "data is 3, expected values with names"),
        ({"data": {}}, "data.size is missing"),
        ({"data": {"size": None}}, "data.size is None, expected a number"),
    ],
)
def test_the_value_that_does_not_belong_is_named(change, says):
    assert says in wrong_kind({**USUAL, **change}, USUAL)


@pytest.mark.parametrize("change", [{}, {"seed": 3.5}, {"file": "a"}, {"file": 5}, {"hidden": []}, {"more": [1]}, {"name": ""}])
def test_what_belongs_is_not_blamed(change):
    assert wrong_kind({**USUAL, **change}, USUAL) is None


def test_a_command_names_it_and_leaves_nothing(run):
    outcome = run("train", "data=5")
    refused(outcome, "data is 5, expected values with names")
    assert not outcome.folder.exists()
