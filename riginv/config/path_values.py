"""Paths on a command line, taken literally, although Hydra's grammar gives brackets, commas, `=`, quotes and numbers a meaning.

`clip=take (1).obj` is no text to Hydra, `out=2024_05` the number 202405, `clip=a,b.obj` a sweep. So the values of keys that are
paths are put into quotes before Hydra sees them. Left as they are: null, what is quoted already, interpolations (`${...}`),
and in a sweep what means several values, unless a file has that very name.
"""

import os
import re
from collections.abc import Sequence
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.errors import HydraException

NAMES = {"clip", "capture", "out", "bundle", "verify", "file", "folder", "store", "interpreter", "mask"}  # after the last dot
KEYS = {"reading.vertices", "rig.neutral", "hydra.run.dir", "hydra.sweep.dir", "scan", "landmarks", "landmarks.map", "markers"}
KEYS |= {"anchors", "prior", "actor.neutral", "curves", "inputs"}
VALUE = re.compile(r"(\+{0,2}([A-Za-z_][\w.]*)=)(.+)", re.DOTALL)
SWEEPS = {"-m", "--multirun", "hydra.mode=MULTIRUN"}


def with_quoted_paths(arguments: Sequence[str]) -> list[str]:
    """The arguments of a command; paths that Hydra would parse as something else are put in quotes.

    Example:
        >>> with_quoted_paths(["clip=take (1).obj", "seed=1"])
        ['clip="take (1).obj"', 'seed=1']
    """
    sweeps = bool(SWEEPS & set(arguments))
    return [_with_quoted_path(argument, sweeps) for argument in arguments]


def quoted(text: str) -> str:
    """A text in quotes, from which Hydra reads back exactly the text."""
    return QuotedString(text, Quote.double).with_quotes()


def _with_quoted_path(argument: str, sweeps: bool) -> str:
    found = VALUE.fullmatch(argument)
    if not found or "${" in argument or not (found[2] in KEYS or found[2].rpartition(".")[2] in NAMES):
        return argument
    start, value = found[1], found[3]
    if value == "~" or value.startswith("~/"):  # of the user: shells leave it behind `=`
        value = os.path.expanduser(value)
        argument = start + value
    override = _parsed(argument)
    means = override.value() if override is not None and not override.is_sweep_override() else override
    if isinstance(means, str) and means == value:
        return argument
    is_hydras = means is None or isinstance(means, str | list | dict) or (sweeps and isinstance(means, Override))
    if override is not None and is_hydras and value == value.strip() and not _exists(value):
        return argument
    return start + quoted(value)


def _parsed(argument: str) -> Override | None:
    """The value that Hydra parses from an argument; None where it cannot parse it."""
    try:
        return OverridesParser.create().parse_override(argument)
    except HydraException:
        return None


def _exists(value: str) -> bool:
    try:
        return Path(value).exists()
    except (OSError, ValueError):
        return False
