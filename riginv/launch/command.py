"""The common part of all commands: Hydra composes the config, and a user's mistake ends in one sentence."""

import functools
import gc
import logging
import os
import re
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.object_type import ObjectType
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.markup import escape

from riginv.config.building import OURS
from riginv.config.folders import check_config_folders
from riginv.config.messages import CONFIGS, explain
from riginv.config.path_values import quoted, with_quoted_paths
from riginv.errors import InputError, listed
from riginv.launch.job_process import exit_with_parent
from riginv.launch.rank_process import exit_with_launcher, is_rank_process, report
from riginv.launch.sweep_folder import register_sweep_resolvers, swept, with_sweep_folder
from riginv.launch.sweep_record import FINISHED, read_record
from riginv.launch.terminal import (
    exit_on_broken_pipe,
    filter_warnings,
    interrupt_as_exception,
    interrupt_at_once,
    stop_interrupted,
)
from riginv.runs.locks import unlock_folders
from riginv.runs.run_folder import CONFIG, discard_if_empty, register_folder_resolvers

POSITIONAL = {"inspect": "clip"}  # the key of a command's positional argument
ANSWERED_BY_HYDRA = ("--help", "-h", "--hydra-help", "--version", "--cfg", "-c", "--info", "-i")
OVERRIDE = re.compile(r"~|\+{0,2}[A-Za-z_][\w./@:-]*=")  # what Hydra takes for KEY=VALUE
OPTIONS_WITH_VALUES = "--config-dir -cd --config-path -cp --config-name -cn --cfg -c --package -p --experimental-rerun".split()
READING = {"reading": "reading/default.yaml", "frames": "frames/all.yaml"}  # groups of every command that reads a clip


def command(config_name: str) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Turn a function of a config into a command line with the config `conf/CONFIG_NAME.yaml`."""

    def decorate(task: Callable[[DictConfig], None]) -> Callable[[], None]:
        @functools.wraps(task)
        def main() -> None:
            if not gc.isenabled():  # by `answer_help`, in this process
                gc.freeze()  # what was imported stays
                gc.enable()
            interrupt_as_exception()
            os.environ["HYDRA_FULL_ERROR"] = "1"  # pass exceptions on: `explain` formats them
            if is_rank_process():
                exit_with_launcher()
            exit_with_parent()
            filter_warnings()
            register_folder_resolvers()
            register_sweep_resolvers()
            register_help_resolvers()
            with exit_on_broken_pipe():
                _run(_Job(task, config_name), config_name)

        return main

    return decorate


def answer_help(module: str, config_name: str) -> None:
    """Answer --help and similar options, and exit; called before a command imports torch, which takes seconds.

    Otherwise garbage is not collected until the command starts: imports leave none, and looking for it takes 0.3 s.
    Ctrl-C ends the process at once until then.

    Args:
        module: `__name__` of the command. Nothing happens where it is not `__main__`.
    """
    if module != "__main__":
        return
    gc.disable()
    interrupt_at_once()
    if any(argument in ANSWERED_BY_HYDRA for argument in sys.argv[1:]):
        command(config_name)(lambda config: None)()
        sys.exit()


def _run(job: "_Job", config_name: str) -> None:
    """Compose the config of a command line with Hydra, and run its job."""
    try:
        options, values = split_options(sys.argv[1:])
        values = path_as_value(values, POSITIONAL.get(config_name))
        arguments = [true_rig_choice(argument) for argument in with_quoted_paths([*options, *values])]
        check_config_folders(arguments)
        sys.argv[1:] = with_sweep_folder(arguments, config_name)
        hydra.main(version_base="1.3", config_path=str(CONFIGS), config_name=config_name)(job.run)()
    except KeyboardInterrupt as interruption:
        stop_interrupted(interruption)
    except SystemExit as ending:
        if isinstance(ending.__context__, KeyboardInterrupt) and not ending.__suppress_context__:  # Lightning exits by itself
            stop_interrupted(ending.__context__)
        raise
    except Exception as error:
        _stop(error, config_name)
    if job.error is not None:
        _stop(job.error, config_name)


def split_options(arguments: list[str]) -> tuple[list[str], list[str]]:
    """The options of a command line with their values, and everything else."""
    options, values = [], []
    waiting = False  # for the value of an option
    for argument in arguments:
        if waiting or argument.startswith("-"):
            options.append(argument)
            waiting = not waiting and argument in OPTIONS_WITH_VALUES
        else:
            values.append(argument)
    return options, values


def path_as_value(values: list[str], key: str | None) -> list[str]:
    """Turn positional paths, as in `riginv.inspect PATH`, into KEY=PATH.

    Args:
        key: None for commands that take no path so.
    """
    if key is None:
        return values
    paths = [value for value in values if not OVERRIDE.match(value) or os.path.exists(value)]
    if len(paths) > 1:
        raise InputError(
            f"{len(paths)} paths were given ({listed(paths, 2)}), expected one: a pattern in quotes ('take.*.obj') is a "
            f"clip of many files"
        )
    literal = [quoted(value.replace("${", "\\${")) for value in values]  # no interpolation, whatever letters it has
    return [f"{key}={text}" if value in paths else value for value, text in zip(values, literal)]


def true_rig_choice(argument: str) -> str:
    """Convert `true_rig=NAME` to a choice from the group of rigs, as `rig=NAME` is."""
    return f"rig@{argument}" if argument.startswith("true_rig=") else argument


class _Job:
    """Runs a task and keeps its exception, so that Hydra does not print it first.

    In a sweep a failed job writes failure.txt, and the others continue.
    """

    def __init__(self, task: Callable[[DictConfig], None], config_name: str) -> None:
        self.task, self.config_name = task, config_name
        self.error: Exception | None = None

    @property
    def module(self) -> str:
        """The module of the command, as in `python -m MODULE`."""
        name, spec = self.task.__module__, sys.modules["__main__"].__spec__
        return spec.name if name == "__main__" and spec is not None else name

    def run(self, config: DictConfig) -> None:
        if HydraConfig.get().mode == RunMode.MULTIRUN:
            self.run_in_sweep(config)
            return
        try:
            self._work(config)
        except Exception as error:
            discard_if_empty(run_directory())
            self.error = error
        except KeyboardInterrupt as interruption:
            discard_if_empty(run_directory())
            if not interruption.args and "resume" in config and (run_directory() / CONFIG).is_file():
                interruption.args = ("go on with the same command plus resume=true",)
            raise

    def run_in_sweep(self, config: DictConfig) -> None:
        """Run a job of a sweep in this process; skip it if finished, resume it if started."""
        folder, chosen = run_directory(), HydraConfig.get()
        sweep = Path(os.path.abspath(chosen.sweep.dir))
        overrides = list(chosen.overrides.task)
        record = read_record(sweep, chosen.job.num, str(folder.relative_to(sweep)), swept(sweep, overrides))
        if record.state == FINISHED:
            Console(stderr=True).print(f"{escape(record.label)}  finished before", highlight=False)
            return
        if record.starts and "resume" in config:
            config.resume = True
        record.started(sweep)
        began, why = time.perf_counter(), None
        try:
            self._work(config)
        except Exception as error:
            why = explain(error, self.config_name) or traceback.format_exc()
            Console(stderr=True).print(f"[bold red]this job failed:[/] {escape(why)}", highlight=False)
        record.ended(sweep, time.perf_counter() - began, why)

    def _work(self, config: DictConfig) -> None:
        for package in OURS:  # `verbose` shows the log messages of rigs about their files
            logging.getLogger(package).setLevel(logging.DEBUG if config.get("verbose") else logging.NOTSET)
        try:
            self.task(config)
        finally:
            unlock_folders()


def run_directory() -> Path:
    """The folder that Hydra gave this run."""
    return Path(HydraConfig.get().runtime.output_dir)


def _stop(error: Exception, config_name: str) -> None:
    message = explain(error, config_name)
    if is_rank_process():
        report(error, message)
        sys.exit(1)
    if message is None:
        raise error
    Console(stderr=True).print("[bold red]error:[/]", escape(message), highlight=False, soft_wrap=True)
    sys.exit(1)


def register_help_resolvers() -> None:
    """Register the resolvers of help texts, each named as its function: `${explained_keys:COMMAND}`."""
    for resolve in (explained_keys, group_choices, plain_help):
        OmegaConf.register_new_resolver(resolve.__name__, _escaped(resolve), replace=True, use_cache=True)


def _escaped(resolve: Callable[[str], str]) -> Callable[[str], str]:
    """A resolver whose text keeps its dollar signs when Hydra substitutes $CONFIG."""
    return lambda name: resolve(name).replace("$", "$$")


def explained_keys(command: str) -> str:
    """The keys of `conf/COMMAND.yaml`, and of how it reads a clip, with their values and comments."""
    lines = _lines(f"{command}.yaml")
    head = lines.index("defaults:")
    body = next(number for number, line in enumerate(lines[head + 1 :], head + 1) if not line.startswith(" "))
    shared = [line for line in _lines("run/sweep.yaml") if line.startswith("verbose:")]  # keys of every command
    reading = [row for group in READING if f"  - {group}:" in "\n".join(lines[head:body]) for row in _group_keys(group)]
    own = re.sub(r"^reading:\n(?:  .*\n)*", "", "\n".join(lines[body:]) + "\n", flags=re.MULTILINE)  # what follows own keys
    return "\n".join(f"  {line}".rstrip() for line in [*own.splitlines(), *shared, *reading]).strip("\n")


def plain_help(command: str) -> str:
    """The help of a command that has no text of its own: the first line of `conf/COMMAND.yaml`, and its keys."""
    lines = _lines(f"{command}.yaml")
    rigs = f"\n\nGroups (GROUP=CHOICE):\n\n  rig: {group_choices('rig')}" if any("  - rig:" in line for line in lines) else ""
    return f"{lines[0].removeprefix('# ')}\n\nKeys:\n\n{explained_keys(command)}{rigs}"


def _group_keys(group: str) -> list[str]:
    """The keys of a group's only choice that have a comment, below the group's name."""
    about, *keys = _lines(READING[group])
    return [f"{group + ':':25} {about}", *(f"  {line}" for line in keys if " # " in line)]


def group_choices(group: str) -> str:
    """The choices of a group, by name; those of --config-dir, too."""
    loader = GlobalHydra.instance().config_loader()
    return ", ".join(sorted(loader.get_group_options(group, ObjectType.CONFIG)))


def _lines(name: str) -> list[str]:
    return (CONFIGS / name).read_text(encoding="utf-8").splitlines()
