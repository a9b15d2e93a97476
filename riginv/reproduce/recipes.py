"""From the settings of a budget to the configs of trainings and methods."""

import copy
import functools
from collections.abc import Mapping, Sequence
from typing import Any

from hydra import compose

from riginv.config.typed import to_typed
from riginv.errors import InputError
from riginv.evaluation.models import surrogate_config
from riginv.runs.run_folder import plain_config
from riginv.training.config import TrainConfig

Config = dict[str, Any]
TEST_SHARE = 10  # one sample in so many judges
ITSELF = {"_target_": None}


def training_config(settings: Sequence[str], rig: Mapping[str, Any], seed: int) -> Config:
    """The plain config of a training: that of `riginv.train` with settings, of which a later one replaces an earlier one.

    Raises:
        InputError: a setting is not what its key must be.
        HydraException: a setting cannot be read, or there is no such key.
    """
    last = {setting.partition("=")[0]: setting for setting in settings}
    plain = copy.deepcopy(_composed(*last.values())) | {"rig": dict(rig), "true_rig": ITSELF, "seed": seed, "capture": None}
    if (devices := to_typed(plain, TrainConfig).trainer.processes) > 1:
        raise InputError(f"a budget asks for {devices} devices: riginv.reproduce trains on one (trainer.devices=1)")
    return plain


@functools.lru_cache(maxsize=64)
def _composed(*settings: str) -> Config:
    return plain_config(compose("train", list(settings)))


def through_surrogate(config: Config) -> Config:
    """The same training through a surrogate, whose bundle the step fills in."""
    return {**config, "rig": surrogate_config("")}


def method_config(name: str, **changed: Any) -> Config:
    """The plain config of a method of `riginv.compare`."""
    return {**plain_config(compose("compare", [f"methods=[{name}]"]))["methods"][name], **changed}


def network_settings(budget: Mapping[str, Any], name: str) -> list[str]:
    """The settings of a network of a budget."""
    network = budget["networks"][name]
    steps = [] if network["steps"] is None else [f"trainer.max_steps={network['steps']}"]
    stored = [f"data.stored_poses={training_samples(budget)}"] if name == "surrogate" else []
    return [*budget["settings"], *network["settings"], *stored, *steps]


def test_samples(budget: Mapping[str, Any]) -> int:
    """The tenth of the samples that judges."""
    return max(1, budget["samples"] // TEST_SHARE)


def training_samples(budget: Mapping[str, Any]) -> int:
    """The samples that a surrogate learns from."""
    return max(1, budget["samples"] - test_samples(budget))
