"""Processes that run steps."""

import contextlib
import shutil
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from riginv.config.typed import to_plain, to_typed
from riginv.errors import InputError, NonFiniteLossError
from riginv.launch.terminal import filter_warnings
from riginv.reproduce.evaluation import EvaluateControls, EvaluateRig, SamplePoses
from riginv.reproduce.inversion import InvertSets
from riginv.reproduce.measures import MeasureControls, MeasureLipschitz
from riginv.reproduce.pictures import DrawBody, DrawDenoising, DrawErrorMaps
from riginv.reproduce.plots import PlotControls, PlotRoughness, PlotTraining
from riginv.reproduce.steps import LOG, Context, Task, Workspace, write_done
from riginv.reproduce.training import TrainNetwork
from riginv.runs.worker import serve

TASKS: dict[str, type[Task]] = {
    kind.__name__: kind
    for kind in (
        *(SamplePoses, TrainNetwork, InvertSets, EvaluateControls, EvaluateRig, MeasureLipschitz, MeasureControls),
        *(DrawDenoising, DrawBody, DrawErrorMaps, PlotRoughness, PlotTraining, PlotControls),
    )
}
FULL_BYTES = 2_000_000  # a disk with less free space is full


@dataclass(frozen=True)
class Failure:
    """A failed step.

    Attributes:
        sentence: for the user; None: an error of riginv.
    """

    sentence: str | None
    trace: str


def run_step(task: Task, at: Workspace) -> None:
    """Run a step in its folder, with its output in the folder's log, and mark it as finished."""
    at.folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with (at.folder / LOG).open("a", encoding="utf-8") as log:
        with contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
            figures = task.run(at)
    write_done(at.folder, time.monotonic() - began, figures)


def attempt(task: Task, at: Workspace) -> Failure | None:
    """Run a step; None: it is finished."""
    try:
        run_step(task, at)
    except (InputError, NonFiniteLossError) as error:
        return Failure(str(error), traceback.format_exc())
    except OSError as error:
        return Failure(f"{error}; free or unlock what it names, then type the same command again", traceback.format_exc())
    except Exception:
        if shutil.disk_usage(at.folder).free < FULL_BYTES:  # libraries report a full disk in various ways
            return Failure("the disk is full: free some of it, then type the same command again", traceback.format_exc())
        return Failure(None, traceback.format_exc())
    return None


def request_header(task: Task, at: Workspace) -> dict[str, Any]:
    """The request to a worker to run a step."""
    facts = {"folder": str(at.folder), "inputs": dict(at.inputs), "context": to_plain(at.context)}
    return {"command": "run", "kind": type(task).__name__, "task": to_plain(task), **facts}


def failure_in(header: Mapping[str, Any]) -> Failure | None:
    """The failure in an answer of a worker; None: the step is finished."""
    return Failure(header["sentence"], header["trace"]) if header["trace"] else None


def _answer(header: dict[str, Any]) -> dict[str, Any]:
    if header["command"] == "load":
        filter_warnings()
        torch.set_num_threads(1)
        return {}
    task = to_typed(header["task"], TASKS[header["kind"]])
    at = Workspace(Path(header["folder"]), header["inputs"], to_typed(header["context"], Context))
    failure = attempt(task, at)
    return {"sentence": failure.sentence if failure else None, "trace": failure.trace if failure else ""}


if __name__ == "__main__":
    serve(_answer)
