"""Error messages: from an exception to one sentence for the user."""

import errno
import os
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import yaml
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from riginv.config.aliases import CHOICES, present_key
from riginv.config.path_values import quoted
from riginv.config.values import did_you_mean
from riginv.errors import InputError, NonFiniteLossError

PACKAGE = Path(__file__).parent.parent
DISK_FAULTS = (errno.EACCES, errno.EROFS, errno.ENOTDIR)
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
CONFIGS = PACKAGE / "conf" if (PACKAGE / "conf").is_dir() else PACKAGE.parent / "conf"  # installed, or in a checkout


def explain(error: BaseException, config_name: str) -> str | None:
    """The message for a user's mistake, or None for a bug."""
    causes = list(_causes(error))
    for cause in causes:
        if isinstance(cause, InputError | NonFiniteLossError):
            return str(cause)
    for cause in causes:
        if isinstance(cause, MissingConfigException):
            return _unknown_choice(cause)
        if isinstance(cause, OverrideParseException):
            return (
                f"cannot read the argument '{cause.override}': expected KEY=VALUE or GROUP=CHOICE{_in_quotes(cause.override)}"
            )
        if isinstance(cause, ConfigCompositionException) and (key := re.match(r"Could not override '([^']+)'", str(cause))):
            if present := present_key(key[1]):
                return f"{key[1]} is named {present} now"
            return f"{key[1]}: there is no such key{did_you_mean(key[1], _known_keys(config_name))} --cfg job shows them all"
    if any(_says_full(cause) for cause in causes):
        return (
            "the disk is full: free some of it, then type the same command again; resume=true goes on with a run that had begun"
        )
    for cause in causes:
        if isinstance(cause, OSError) and cause.errno in DISK_FAULTS:
            where = f"{cause.filename}: " if cause.filename else ""
            return f"{where}cannot be written: {os.strerror(cause.errno)}; choose another folder with hydra.run.dir=DIR"
    for cause in causes:
        if isinstance(cause, yaml.YAMLError):
            return f"a config cannot be read as YAML of plain values: {' '.join(str(cause).split())[:300]}"
    if any(isinstance(cause, HydraException | OmegaConfBaseException) for cause in causes):
        return " ".join(str(causes[-1]).split("\n")[0].split())
    return None


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _says_full(error: BaseException) -> bool:
    """Whether an error reports a full disk; libraries that write by themselves put the system's words into their own."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno in FULL
    return any(os.strerror(number) in str(error) for number in FULL)


def _unknown_choice(error: MissingConfigException) -> str:
    missing = error.missing_cfg_file or ""
    path = (missing if isinstance(missing, str) else "/".join(missing)).removesuffix(".yaml")
    group, _, choice = path.rpartition("/")
    for argument in sys.argv[1:]:
        typed, _, choices = argument.lstrip("+~").partition("=")
        for one in choices.strip("[]").split(","):
            if f"{typed.partition('@')[0]}/{one}" == path:
                group, choice = typed.partition("@")[0], one
    if present := CHOICES.get(group, {}).get(choice):
        return f"{group}={choice} is named {group}={present} now"
    folder, kind = CONFIGS / group, group.replace("methods", "method")
    files = [] if "/" in choice else list(folder.glob("*.yaml"))  # of choices in folders all are shown
    files = files or list(folder.rglob("*.yaml"))
    known = {file.relative_to(folder).with_suffix("").as_posix() for file in files}
    known |= {option for option in error.options or [] if not (folder / option).is_dir()}
    return f"{group}={choice}: there is no such {kind}{did_you_mean(choice, known)} Known: {', '.join(sorted(known))}"


def _in_quotes(argument: str | None) -> str:
    """A hint on quotes for an argument whose text Hydra parses as something else."""
    key, equals, value = (argument or "").partition("=")
    if any(value.count(left) != value.count(right) for left, right in ("[]", "{}")):
        return "; a bracket in it does not close: put the whole argument in single quotes, such as 'formats=[csv, anim]'"
    return f"; a value with brackets, quotes or the like: {shlex.quote(f'{key}={quoted(value)}')}" if equals and value else ""


def _known_keys(config_name: str) -> set[str]:
    """The keys of a command's default config."""
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(CONFIGS), version_base="1.3"):
            config = compose(config_name)
    except (HydraException, OmegaConfBaseException):
        return set()
    return {key for key in _keys(config) if not key.endswith("_target_")}


def _keys(config: DictConfig, prefix: str = "") -> Iterator[str]:
    for key in map(str, config):
        inner = None if OmegaConf.is_interpolation(config, key) or OmegaConf.is_missing(config, key) else config.get(key)
        yield f"{prefix}{key}"
        if isinstance(inner, DictConfig):
            yield from _keys(inner, f"{prefix}{key}.")
