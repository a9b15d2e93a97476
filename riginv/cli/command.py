"""What every command line shares: Hydra composes the config, and a user's mistake ends in one sentence."""

import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from riginv.cli.blame import blame
from riginv.cli.config_folders import check_config_folders
from riginv.cli.explain import CONFIGS, explain
from riginv.cli.quiet import hush
from riginv.cli.run_folder import discard_if_empty, register_folder_resolvers
from riginv.errors import InputError

FAILURE = "failure.txt"
OPTIONS_WITH_VALUES = "--config-dir -cd --config-path -cp --config-name -cn --cfg -c --package -p --experimental-rerun".split()


def command(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Turn a function of a config into a command line with the config `conf/CONFIG_NAME.yaml`."""

    def decorate(task: Callable[[DictConfig], None]) -> Callable[[], None]:
        @functools.wraps(task)
        def main() -> None:
            os.environ["HYDRA_FULL_ERROR"] = "1"  # let errors through: `explain` says them better
            hush()
            register_folder_resolvers()
            sys.argv[1:] = [true_rig_choice(argument) for argument in options_first(sys.argv[1:])]
            job = _Job(task, config_name)
            try:
                check_config_folders(sys.argv[1:])
                hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=config_name)(job.run)()
            except Exception as error:
                _stop(error, config_name)
            if job.error is not None:
                _stop(job.error, config_name)
            if job.failed:
                _stop(
                    InputError(f"{len(job.failed)} of {job.count} jobs failed; each says why in {FAILURE} in its folder"),
                    config_name,
                )

        return main

    return decorate


def options_first(arguments: list[str]) -> list[str]:
    """Put options before KEY=VALUE arguments: Hydra's parser takes them in no other order, users write them in any."""
    options, values = [], []
    waiting = False  # for the value of an option
    for argument in arguments:
        if waiting or argument.startswith("-"):
            options.append(argument)
            waiting = not waiting and argument in OPTIONS_WITH_VALUES
        else:
            values.append(argument)
    return options + values


def true_rig_choice(argument: str) -> str:
    """Let `true_rig=NAME` choose from the group of rigs, as `rig=NAME` does."""
    return f"rig@{argument}" if argument.startswith("true_rig=") else argument


class _Job:
    """Runs a task, and keeps the error of one that failed, so that Hydra does not speak of it first.

    In a sweep a job that fails by a user's mistake says why and lets the others go on; the table at the end counts it.
    """

    def __init__(self, task: Callable[[DictConfig], None], config_name: str) -> None:
        self.task, self.config_name = task, config_name
        self.error: Exception | None = None
        self.count, self.failed = 0, []

    def run(self, config: DictConfig) -> None:
        folder = run_directory()
        self.count += 1
        try:
            self.task(config)
        except Exception as error:
            discard_if_empty(folder)
            message = explain(error, self.config_name)
            hydra = HydraConfig.get()
            if message is None and (message := blame(error, config, self.config_name, hydra)):
                error = InputError(message)
            if message is None or hydra.mode != RunMode.MULTIRUN:
                self.error = error
                return
            self.failed.append(folder.name)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / FAILURE).write_text(message + "\n", encoding="utf-8")
            Console(stderr=True).print(f"[bold red]this job failed:[/] {escape(message)}", highlight=False)


def run_directory() -> Path:
    """The folder that Hydra gave this run."""
    return Path(HydraConfig.get().runtime.output_dir)


def _stop(error: Exception, config_name: str) -> None:
    message = explain(error, config_name)
    if message is None:
        raise error
    Console(stderr=True).print("[bold red]error:[/]", escape(message), highlight=False, soft_wrap=True)
    sys.exit(1)
