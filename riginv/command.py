"""What every command line shares: Hydra composes the config, and a user's mistake ends in one sentence."""

import difflib
import functools
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from riginv.errors import InputError, NonFiniteLossError
from riginv.quiet import hush
from riginv.run_folder import discard_if_empty, register_run_folder_resolver

PACKAGE = Path(__file__).parent
CONFIGS = PACKAGE / "conf" if (PACKAGE / "conf").is_dir() else PACKAGE.parent / "conf"  # installed, or in a checkout
FAILURE = "failure.txt"


def command(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Turn a function of a config into a command line with the config `conf/CONFIG_NAME.yaml`."""

    def decorate(task: Callable[[DictConfig], None]) -> Callable[[], None]:
        @functools.wraps(task)
        def main() -> None:
            os.environ["HYDRA_FULL_ERROR"] = "1"  # let errors through: `explain` says them better
            hush()
            register_run_folder_resolver()
            job = _Job(task)
            try:
                hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=config_name)(job.run)()
            except Exception as error:
                _stop(error)
            if job.error is not None:
                _stop(job.error)

        return main

    return decorate


class _Job:
    """Runs a task, and keeps the error of one that failed, so that Hydra does not speak of it first.

    In a sweep a job that fails by a user's mistake says why and lets the others go on; the table at the end counts it.
    """

    def __init__(self, task: Callable[[DictConfig], None]) -> None:
        self.task, self.error = task, None

    def run(self, config: DictConfig) -> None:
        folder = run_directory()
        try:
            self.task(config)
        except Exception as error:
            discard_if_empty(folder)
            message = explain(error)
            if message is None or HydraConfig.get().mode != RunMode.MULTIRUN:
                self.error = error
                return
            folder.mkdir(parents=True, exist_ok=True)
            (folder / FAILURE).write_text(message + "\n", encoding="utf-8")
            Console(stderr=True).print(f"[bold red]this job failed:[/] {message}", highlight=False)


def run_directory() -> Path:
    """The folder that Hydra gave this run."""
    return Path(HydraConfig.get().runtime.output_dir)


def explain(error: BaseException) -> str | None:
    """The sentence that a user needs, or None for a fault of ours."""
    for cause in _causes(error):
        if isinstance(cause, InputError | NonFiniteLossError):
            return str(cause)
    for cause in _causes(error):
        if isinstance(cause, MissingConfigException):
            return _unknown_choice(cause)
        if isinstance(cause, OverrideParseException):
            return f"cannot read the argument '{cause.override}': expected key=value"
        if isinstance(cause, ConfigCompositionException | HydraException | OmegaConfBaseException):
            return " ".join(str(_deepest(cause)).split("\n")[0].split())
    return None


def _stop(error: Exception) -> None:
    message = explain(error)
    if message is None:
        raise error
    Console(stderr=True).print("[bold red]error:[/]", message, highlight=False, soft_wrap=True)
    sys.exit(1)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _deepest(error: BaseException) -> BaseException:
    return list(_causes(error))[-1]


def _unknown_choice(error: MissingConfigException) -> str:
    missing = error.missing_cfg_file or ""
    name = (missing if isinstance(missing, str) else "/".join(missing)).split("/")
    group, choice = "/".join(name[:-1]), name[-1]
    options = sorted(error.options or [])
    near = difflib.get_close_matches(choice, options, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    return f"{group}={choice}: there is no such {group or 'config'}; {hint}Known: {', '.join(options)}"
