"""A sweep's folder: named after the overrides of the command line, and found again by `resume=true`."""

import datetime
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from omegaconf import OmegaConf

from riginv.errors import InputError
from riginv.launch.sweep_record import JOBS
from riginv.runs.run_folder import TIME, folder_name

SWEEPS = Path("runs") / "sweep"
TYPED = "multirun.yaml"  # Hydra writes it before the first job starts
FOLDER = "hydra.sweep.dir="
LONGEST = 80  # characters of its name
IN_BRACKETS = re.compile(r"\[[^\]]*\]|\{[^}]*\}|\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'")  # a list or a text is one value
SWEPT = re.compile(r"=.*,|=(range|choice|glob)\(")
NOT_OF_THE_TASK = ("hydra.", "hydra/", "resume=", "verbose=", "-")


def register_sweep_resolvers() -> None:
    """Register the resolvers `${sweep_folder:command,overrides}` and `${sweep_job:number,folder,overrides}` of configs."""
    OmegaConf.register_new_resolver("sweep_folder", new_sweep_folder, replace=True, use_cache=True)
    OmegaConf.register_new_resolver("sweep_job", job_name, replace=True)


def new_sweep_folder(command: str, overrides: Sequence[str]) -> str:
    """`runs/sweep/TIME_COMMAND_WHAT-IS-SWEPT`, such as `2026-11-22_16-10-00_train_seed-0-1-2`."""
    shown = [text for text in overrides if text.startswith("experiment=") or SWEPT.search(IN_BRACKETS.sub("", text))]
    name = "_".join([datetime.datetime.now().strftime(TIME), command, *map(_plain, shown)])[:LONGEST]
    taken = len(list(SWEEPS.glob(f"{name}*")))
    return str(SWEEPS / (f"{name}_{taken + 1}" if taken else name))


def job_name(number: int, folder: str, overrides: Sequence[str]) -> str:
    """`NUMBER_SWEPT-VALUES`, such as `03_model-holden_seed-1`."""
    return folder_name("_".join([f"{number:02d}", *map(_plain, swept(Path(folder), overrides))]))


def swept(folder: Path, overrides: Sequence[str]) -> list[str]:
    """The swept overrides of a job: those that differ from what was typed."""
    shared = [_as_hydra_writes(text) for text in typed_before(folder) or []]
    return [text for text in overrides if _as_hydra_writes(text) not in shared and not text.startswith(NOT_OF_THE_TASK)]


def _as_hydra_writes(override: str) -> str:
    """An override with a truth value in small letters: Hydra gives jobs `True` for `true`."""
    key, equals, value = override.partition("=")
    return f"{key}{equals}{value.lower()}" if value.lower() in ("true", "false") else override


def typed_before(folder: Path, command: str | None = None) -> list[str] | None:
    """The arguments of the sweep in a folder, without `resume`; None where there is none (of that command)."""
    try:
        hydra: Any = yaml.safe_load((folder / TYPED).read_text(encoding="utf-8"))["hydra"]
        name, arguments = hydra["job"]["config_name"], hydra["overrides"]["task"]
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        return None
    return None if command not in (None, name) else [text for text in arguments if not text.startswith(NOT_OF_THE_TASK)]


def with_sweep_folder(arguments: list[str], command: str) -> list[str]:
    """Complete a command line that resumes a sweep: by the sweep's folder, and by what was typed when it began.

    Args:
        arguments: options first.
        command: the name of its config.

    Raises:
        InputError: the folder holds another sweep, or one that was not asked to be resumed.
    """
    if not {"-m", "--multirun", "hydra.mode=MULTIRUN"} & set(arguments):
        return arguments
    resume = any(text.lower() == "resume=true" for text in arguments)
    folders = [Path(text.removeprefix(FOLDER).strip("'\"")) for text in arguments if text.startswith(FOLDER)]
    typed = [text for text in arguments if re.search("=|^~", text) and not text.startswith(NOT_OF_THE_TASK)]
    options = [text for text in arguments if text not in typed]
    if not folders:
        same = [path for path in sorted(SWEEPS.glob("*")) if _same(_typed_for_job(path, command), typed)] if resume else []
        return [*options, *(typed_before(same[-1]) or []), f"{FOLDER}{same[-1]}"] if same else arguments
    before = _typed_for_job(folders[-1])
    if before is None:
        return arguments
    if not resume:
        raise InputError(
            f"{folders[-1]} holds a sweep already: add resume=true to run the jobs that are missing, "
            "or choose another hydra.sweep.dir=DIR"
        )
    if typed and not _same(before, typed):
        raise InputError(
            f"{folders[-1]} holds another sweep, of {' '.join(before)}: give the same arguments, or none, "
            "or choose another hydra.sweep.dir=DIR"
        )
    return [*options, *before]


def _typed_for_job(folder: Path, command: str | None = None) -> list[str] | None:
    """As `typed_before`, where a job was started: Hydra writes its file even if it refuses the arguments."""
    return typed_before(folder, command) if (folder / JOBS).is_dir() else None


def _same(before: list[str] | None, typed: list[str]) -> bool:
    return before is not None and sorted(before) == sorted(typed)


def _plain(text: str) -> str:
    """A text without characters that are special in a shell or in Hydra: `seed=0` becomes `seed-0`."""
    return re.sub(r"[^\w.+-]", "-", text.replace("=[", "=")).strip("-")
