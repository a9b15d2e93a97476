"""Which value of a config is of another kind than where it stands: asked only when a command has failed for no reason it knows.

What a user gives is compared with the config as its files compose it: a list stays a list, a number a number.
"""

import math
from collections.abc import Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from riginv.config.building import DOES_NOT_FIT
from riginv.config.messages import CONFIGS
from riginv.config.validation import MAY_BE_NULL

KINDS = ((bool, "true or false"), (int | float, "a number"), (str, "text"), (Mapping, "values with names"), (list, "a list"))


def usual_config(config_name: str, hydra: DictConfig) -> Mapping[str, Any] | None:
    """The config of a command with the same choices from its groups, and no value changed; None where it cannot be composed.

    Args:
        hydra: Hydra's own config of the run that failed.
    """
    folders = [source.path for source in hydra.runtime.config_sources if source.provider == "command-line"]
    chosen = [
        f"{group}={choice}"
        for group, choice in hydra.runtime.choices.items()
        if choice and any((Path(folder) / group.partition("@")[0]).is_dir() for folder in (CONFIGS, *folders))
    ]
    if folders:
        chosen.append(f"hydra.searchpath=[{','.join(f'file://{folder}' for folder in folders)}]")
    try:
        GlobalHydra.instance().clear()
        with initialize_config_dir(str(CONFIGS), version_base="1.3"):
            config = compose(config_name, overrides=chosen)
        return plain(config)
    except (HydraException, OmegaConfBaseException, ValueError):
        return None


def plain(config: DictConfig) -> dict[str, Any]:
    """A config as plain values; what cannot be resolved stays as it is written."""
    try:
        found: Any = OmegaConf.to_container(config, resolve=True)
    except OmegaConfBaseException:
        found = OmegaConf.to_container(config, resolve=False)
    return {key: value for key, value in found.items() if key != "hydra"}


def wrong_kind(config: Any, usual: Any, key: str = "") -> str | None:
    """The sentence that names a value of another kind than usual; None where there is none."""
    if isinstance(usual, Mapping) and isinstance(config, Mapping):
        for name, inner in usual.items():
            place = f"{key}.{name}" if key else str(name)
            if name not in config:
                return f"{place} is missing, expected {_kind(inner)}: leave it as it was"
            if sentence := wrong_kind(config[name], inner, place):
                return sentence
        return None
    if isinstance(usual, list) and isinstance(config, list) and usual:
        return next(filter(None, (wrong_kind(one, usual[0], f"{key}[{place}]") for place, one in enumerate(config))), None)
    if usual is None:
        fits = config is None or (isinstance(config, int | float | str) and not isinstance(config, bool))
    else:
        may_be_null = config is None and any(fnmatch(key, pattern) for pattern in MAY_BE_NULL)
        fits = may_be_null or _kind(config) == _kind(usual)
    if fits and not (isinstance(config, float) and not math.isfinite(config)):
        return None
    return f"{key} is {config!r:.80}, expected {_kind(usual) if usual is not None else 'null, a name or a number'}"


def _kind(value: Any) -> str:
    if value == "???":
        return "a value"
    return next((words for kind, words in KINDS if isinstance(value, kind)), "null")


def diagnose(error: Exception, config: DictConfig, config_name: str, hydra: DictConfig) -> str | None:
    """The sentence for a command that failed as it may by a value of another kind than usual, where there is such a value."""
    usual = usual_config(config_name, hydra) if isinstance(error, DOES_NOT_FIT) else None
    return None if usual is None else wrong_kind(plain(config), usual)
