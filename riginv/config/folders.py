"""Checks of config folders given on the command line: their files must not make Hydra instantiate objects.

Hydra makes objects of what is under `hydra` before riginv sees a config: callbacks, launchers, log handlers; and it sets
environment variables. A file of such a folder may choose among launchers and sweepers that are installed, and no more.
"""

import argparse
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from riginv.errors import InputError
from riginv.runs.files import check_values, read_text

PACKAGE = re.compile(r"^\s*#\s*@package\s+(\S+)", re.MULTILINE)
HEADER = 512  # characters, in which Hydra looks for it
REACHES_HYDRA = re.compile(r"@[^:]*(hydra|\$)")  # a line of a defaults list that puts a file under hydra
PLUGINS = ("hydra._internal.core_plugins.", "hydra_plugins.", "riginv.launch.sweep.")
INSTANTIATING_KEYS = ("_target_", "()", "class")  # the latter two in log handlers
NEVER = ("env_set", "searchpath")
BY_HAND = ("interpreter", "scripts")  # they run programs: for the command line
RERUN = "--e"  # of --experimental-rerun, which may be shortened
MOST_FILES = 5000


def check_config_folders(arguments: Sequence[str]) -> None:
    """Check the YAML files of all folders that options of a command line add.

    Raises:
        InputError: a file would have Hydra make objects or set variables, or names a program to run; or an option unpickles.
    """
    for argument in arguments:
        if argument.startswith(RERUN):
            raise InputError(f"{argument} would unpickle a file, which may run anything: give the same arguments again instead")
    parser = argparse.ArgumentParser(add_help=False)
    for names in (("--config-dir", "-cd"), ("--config-path", "-cp"), ("--config-name", "-cn")):
        parser.add_argument(*names, action="append", default=[])
    try:
        given, rest = parser.parse_known_args(list(arguments))
    except SystemExit:  # a value is missing; Hydra says so
        return
    folders = [*given.config_dir, *given.config_path]
    for argument in rest:
        key, _, value = argument.lstrip("+").partition("=")
        if key == "hydra.searchpath":
            folders += [place.strip().strip("'\"").removeprefix("file://") for place in value.strip("[]").split(",")]
    for place in folders:
        if place and "://" not in place and Path(place).is_dir():
            check_folder(Path(place))


def check_folder(folder: Path) -> None:
    """Check the YAML files of a folder; Hydra reports those that cannot be read, if one is chosen.

    Raises:
        InputError: as `check_config_folders`.
    """
    for number, path in enumerate(path for ending in ("*.yaml", "*.yml") for path in folder.rglob(ending)):
        if number >= MOST_FILES:
            raise InputError(f"{folder}: more than {MOST_FILES} YAML files, expected a folder of configs: name that")
        try:
            text = read_text(path)
            content = yaml.safe_load(text)
        except (InputError, yaml.YAMLError, ValueError, RecursionError, TypeError, AttributeError):
            continue
        check_values(path, content)
        if isinstance(content, dict):
            package = PACKAGE.search(text[:HEADER])
            _check_file(path, path.relative_to(folder).parts[0], package[1] if package else "", content)


def _check_file(path: Path, group: str, package: str, content: Mapping[str, Any]) -> None:
    for key, value in _pairs(content):
        if key in BY_HAND and value not in (None, False):
            raise InputError(
                f"{path}: {key} names what may run, which a file cannot: type it on the command line if you trust it"
            )
    for line in _defaults(content):
        if REACHES_HYDRA.search(line):
            raise InputError(f"{path}: its defaults put {line!r:.80} under hydra, where objects are made: leave that out")
    for hydra in (
        content if package.removeprefix("_global_.").startswith("hydra") or group == "hydra" else None,
        content.get("hydra"),
    ):
        if isinstance(hydra, str):
            raise InputError(f"{path}: hydra is {hydra!r:.80}, expected plain values: write them out")
        for key, value in _pairs(hydra):
            what = f"{path}: under hydra, {key} is {value!r:.80}"
            if key in NEVER:
                raise InputError(f"{what}: a file of configs sets no variables and adds no folders; leave it out")
            if key in INSTANTIATING_KEYS and not (key == "_target_" and str(value).startswith(PLUGINS)):
                raise InputError(f"{what}, expected a plug-in of Hydra that is installed: nothing else is run for a config")
            if isinstance(value, str) and re.fullmatch(r"\s*\$\{.*\}\s*", value, re.DOTALL):
                raise InputError(f"{what}, which may resolve to anything: write the value out")


def _pairs(value: Any) -> Iterator[tuple[str, Any]]:
    """All keys with their values, however deep; values in a list have the list's key."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield str(key), inner
            for one in inner if isinstance(inner, list) else ():
                yield str(key), one
            yield from _pairs(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _pairs(inner)


def _defaults(content: Mapping[str, Any]) -> Iterator[str]:
    defaults = content.get("defaults")
    for one in defaults if isinstance(defaults, list) else ():
        yield from (f"{key}: {value}" for key, value in one.items()) if isinstance(one, Mapping) else (str(one),)
