"""From the settings of a budget to the configs of trainings and methods."""

import copy
import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from hydra import compose

from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.errors import InputError
from riginv.evaluation.models import surrogate_config
from riginv.methods.base import Method
from riginv.reproduce.settings import Budget, NetworkBudget
from riginv.rig.interface import RigBackend
from riginv.runs.run_folder import plain_config
from riginv.training.config import TrainConfig


def training_config(settings: Sequence[str], rig: ClassSpec[RigBackend], seed: int) -> TrainConfig:
    """The config of a training with settings, of which a later one replaces an earlier one of the same key.

    Raises:
        InputError: a value of a setting does not fit.
        HydraException: a setting cannot be parsed, or there is no such key.
    """
    last = {setting.partition("=")[0]: setting for setting in settings}
    own = {"rig": dict(rig.config), "true_rig": None, "seed": seed, "capture": None}
    training = to_typed(copy.deepcopy(_composed("train", *last.values())) | own, TrainConfig)
    if (devices := training.trainer.processes) > 1:
        raise InputError(f"a budget has {devices} devices: riginv.reproduce trains on one (trainer.devices=1)")
    return training


@functools.lru_cache(maxsize=64)
def _composed(command: str, *settings: str) -> dict[str, Any]:
    return plain_config(compose(command, list(settings)))


def through_surrogate(training: TrainConfig, bundle: str = "") -> TrainConfig:
    """The same training through the surrogate of a bundle."""
    return replace(training, rig=ClassSpec.read(surrogate_config(bundle), RigBackend, "rig"))


def method_specs(names: Sequence[str], **arguments: Mapping[str, Any]) -> dict[str, ClassSpec[Method]]:
    """Methods of `riginv.compare`, by name, some with further arguments.

    Raises:
        HydraException: there is no such method.
    """
    found = _composed("compare", f"methods=[{','.join(dict.fromkeys(names))}]")["methods"]
    return {name: ClassSpec.read({**found[name], **arguments.get(name, {})}, Method, f"methods.{name}") for name in names}


def network_settings(budget: Budget, name: str) -> list[str]:
    network: NetworkBudget = getattr(budget.networks, name)
    steps = [] if network.steps is None else [f"trainer.max_steps={network.steps}"]
    stored = [f"data.stored_poses={budget.training_samples}"] if name == "surrogate" else []
    return [*budget.settings, *network.settings, *stored, *steps]
