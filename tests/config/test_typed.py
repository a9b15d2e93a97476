"""A config becomes dataclasses, or one sentence names the key, what was found and what is expected."""

from dataclasses import dataclass, field
from typing import Literal

import pytest
from omegaconf import OmegaConf

from riginv.config.building import ClassSpec
from riginv.config.typed import REST, to_typed
from riginv.config.values import Fraction, NonEmpty, NonNegativeFloat, NonNegativeInt, PositiveInt, Widths
from riginv.errors import InputError
from riginv.networks.base import RigNetwork
from riginv.rig.interface import RigBackend
from riginv.training.module import RigModule
from tests.config.test_bad_input import refused

TOY = "tests.support.toys.ToyRig"


@dataclass(frozen=True)
class DataConfig:
    size: PositiveInt


@dataclass(frozen=True)
class ModelConfig:
    module: ClassSpec[RigModule] = field(metadata=REST)
    network: ClassSpec[RigNetwork]


@dataclass(frozen=True)
class Config:
    seed: NonNegativeInt
    name: str
    on: bool
    file: str | float | None
    hidden: Widths
    names: tuple[str, ...]
    data: DataConfig
    most: PositiveInt | Literal["auto"]
    up: Literal["x", "y"] = "y"
    noise: NonNegativeFloat = 0.0
    fraction: Fraction = 0.5
    store: NonEmpty | None = None
    rig: ClassSpec[RigBackend] | None = None
    model: ModelConfig | None = None


USUAL = {
    "seed": 0,
    "name": "x",
    "on": True,
    "file": None,
    "hidden": [8, 8],
    "names": ["a"],
    "data": {"size": 4},
    "most": "auto",
}
NETWORK = {"_target_": "riginv.networks.inverse.DirectInverse", "hidden": [8]}
MODEL = {"_target_": "riginv.training.inverse.InverseModule", "network": NETWORK}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": "five"}, "seed is 'five', expected a whole number of at least 0"),
        ({"seed": True}, "seed is True, expected a whole number"),
        ({"seed": float("nan")}, "seed is nan, expected a whole number"),
        ({"seed": -1}, "seed is -1, expected a whole number of at least 0"),
        ({"on": 1}, "on is 1, expected true or false"),
        ({"name": ["x"]}, "name is ['x'], expected text"),
        ({"hidden": 8}, "hidden is 8, expected a list of whole numbers of at least 1"),
        ({"hidden": [8, "x"]}, "hidden is [8, 'x'], expected a list of whole numbers"),
        ({"hidden": [8, 0]}, "hidden is [8, 0], expected a list of whole numbers of at least 1"),
        ({"names": ["a", True]}, "names[1] is True, expected text"),
        ({"file": {"a": 1}}, "file is {'a': 1}, expected text or a number or null"),
        ({"data": 3}, "data is 3, expected values with names"),
        ({"data": {}}, "data.size is missing, expected a whole number of at least 1"),
        ({"data": {"size": None}}, "data.size is None, expected a whole number"),
        ({"data": {"size": 1, "sizes": 1}}, "data.sizes: there is no such key; did you mean data.size?"),
        ({"most": 0}, "most is 0, expected a whole number of at least 1 or auto"),
        ({"up": "z"}, "up is 'z', expected x or y"),
        ({"noise": float("inf")}, "noise is inf, expected a finite number of at least 0"),
        ({"fraction": 1.5}, "fraction is 1.5, expected a number from 0 to 1"),
        ({"store": ""}, "store is '', expected a path or a URL"),
        ({"verbose": "loud"}, "verbose is 'loud', expected true or false"),
        ({"rig": 5}, "rig is 5, expected"),
        ({"rig": {"_target_": "no.such.Rig"}}, "cannot find the class no.such.Rig"),
        ({"rig": NETWORK}, "which is no riginv.rig.interface.RigBackend"),
        (
            {"rig": {"_target_": TOY, "detial": 2}},
            "rig.detial: tests.support.toys.ToyRig has no such argument; did you mean detail",
        ),
        ({"rig": {"_target_": TOY, "detail": "fine"}}, "rig.detail is 'fine', expected a whole number"),
        ({"model": {**MODEL, "network": {**NETWORK, "hidden": [0]}}}, "model.network.hidden is [0], expected a list"),
        ({"model": {**MODEL, "sampled_vertices": -1}}, "model.sampled_vertices is -1, expected a whole number of at least 0"),
        ({"model": {**MODEL, "samples": 5}}, "model.samples: riginv.training.inverse.InverseModule has no such argument"),
    ],
)
def test_what_does_not_fit_is_named(change, says):
    with pytest.raises(InputError) as refusal:
        to_typed({**USUAL, **change}, Config)
    assert says in str(refusal.value)


@pytest.mark.parametrize("change", [{"file": "a"}, {"file": 5}, {"hidden": []}, {"name": ""}, {"hydra": {"job": 1}}])
def test_what_fits_is_taken(change):
    assert isinstance(to_typed({**USUAL, **change}, Config), Config)


def test_values_are_of_their_types():
    settings = to_typed({**USUAL, "name": 2024, "noise": 1, "file": 5, "rig": {"_target_": None}, "model": MODEL}, Config)
    assert settings.name == "2024" and settings.names == ("a",) and settings.rig is None
    assert isinstance(settings.noise, float) and isinstance(settings.file, float)
    assert settings.model.module.target_class.kind == "inverse" and settings.model.network.arguments == {"hidden": [8]}


def test_a_class_is_built_once_with_its_arguments():
    settings = to_typed({**USUAL, "rig": {"_target_": TOY, "last_name": "whole"}}, Config)
    assert settings.rig.target == TOY and settings.rig.build().control_names[-1] == "whole"


def test_first_keys_of_other_commands_are_left_out():
    assert to_typed({**USUAL, "checkpoint": {"every_n_steps": 5}, "true_rig": None, "trainer": {}}, Config) == to_typed(
        USUAL, Config
    )
    with pytest.raises(InputError, match="sed: there is no such key; did you mean seed?"):
        to_typed({**USUAL, "sed": 3}, Config)


def test_what_must_be_given_is_named():
    with pytest.raises(InputError, match="data.size must be given: add data.size="):
        to_typed(OmegaConf.create({**USUAL, "data": {"size": "???"}}), Config)


def test_a_command_names_it_and_leaves_nothing(run):
    outcome = run("train", "data=5")
    refused(outcome, "data is 5, expected values with names")
    assert not outcome.folder.exists()
