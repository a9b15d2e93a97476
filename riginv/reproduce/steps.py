"""A graph of steps; the folder of each is named after a hash of all that its result depends on."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from riginv.config.building import ClassSpec
from riginv.config.typed import to_plain
from riginv.errors import InputError, in_short
from riginv.reproduce.sets import CaptureSource, SetSizes
from riginv.rig.interface import RigBackend
from riginv.runs.files import write_json

FORMAT = 1  # of a finished step; others are not read
Figures = dict[str, Any]
DONE, LOG = "done.json", "log.txt"


@dataclass(frozen=True)
class Context:
    """The circumstances of a run, which results do not depend on.

    Attributes:
        capture: the captured data, whose content is part of `SetSizes`.
        jobs: number of parallel steps.
    """

    capture: CaptureSource
    jobs: int


@dataclass(frozen=True)
class Workspace:
    """The folders of a step.

    Attributes:
        folder: its own.
        inputs: those of the steps that it reads, by use.
    """

    folder: Path
    inputs: Mapping[str, str]
    context: Context


@dataclass(frozen=True)
class Task(ABC):
    """The work of a step: plain values that its result depends on.

    Attributes:
        draws: whether it draws figures only, so that no other step depends on its code.
    """

    draws: ClassVar[bool] = False
    rig: ClassSpec[RigBackend]
    sets: SetSizes

    @abstractmethod
    def run(self, at: Workspace) -> Figures:
        """Write files into the folder, and return figures."""


@dataclass(frozen=True)
class Step:
    """A step of a graph.

    Attributes:
        name: unique in a graph; words and dashes.
        inputs: names of the steps that it reads, by use.
        expected_s: expected duration.
        about: a few words for progress lines.
    """

    name: str
    task: Task
    context: Context
    inputs: Mapping[str, str] = field(default_factory=dict)
    expected_s: float = 1.0
    about: str = ""


class Graph:
    """Steps and their folders.

    Args:
        steps: each after those that it reads.
        folder: parent of the steps' folders.
        code: hash of the code that results depend on.
        drawing_code: hash of the code that only drawn figures depend on.
    """

    def __init__(self, steps: Sequence[Step], folder: Path, code: str, drawing_code: str = "") -> None:
        self.steps = {step.name: step for step in steps}
        self.folder = folder
        self.keys: dict[str, str] = {}
        for step in steps:
            read = {use: self.keys[name] for use, name in step.inputs.items()}
            made_by = code + drawing_code if step.task.draws else code
            facts = json.dumps([FORMAT, made_by, type(step.task).__name__, to_plain(step.task), read], sort_keys=True)
            self.keys[step.name] = hashlib.sha256(facts.encode()).hexdigest()[:12]

    def path(self, name: str) -> Path:
        """The folder of a step, NAME-KEY."""
        return self.folder / f"{name}-{self.keys[name]}"

    def inputs(self, name: str) -> dict[str, str]:
        """The folders that a step reads, by use."""
        return {use: str(self.path(other)) for use, other in self.steps[name].inputs.items()}

    def is_finished(self, name: str) -> bool:
        return read_done(self.path(name)) is not None

    def figures(self, name: str) -> Figures:
        """The figures of a finished step."""
        return self._done(name)["figures"]

    def seconds(self, name: str) -> float:
        """The duration of a finished step."""
        return self._done(name)["seconds"]

    def _done(self, name: str) -> dict[str, Any]:
        done = read_done(self.path(name))
        if done is None:
            raise InputError(f"{self.path(name) / DONE}: missing or damaged: type the same command again")
        return done

    def stale_steps(self) -> list[str]:
        """Folders of steps of another version of the code or another config."""
        known = {self.path(name).name for name in self.steps}
        return sorted(path.name for path in self.folder.glob("*-*") if path.is_dir() and path.name not in known)


def write_done(folder: Path, seconds: float, figures: Mapping[str, Any]) -> None:
    """Mark a step as finished; written last."""
    write_json(folder / DONE, {"format": FORMAT, "seconds": round(seconds, 2), "figures": figures})


def read_tensors(path: Path) -> dict[str, Tensor]:
    """The tensors in a file of a finished step.

    Raises:
        InputError: they cannot be read.
    """
    try:
        return load_file(path)
    except (OSError, ValueError, KeyError, SafetensorError) as error:
        raise InputError(f"{path}: damaged ({in_short(error)}): remove its folder, and the step is run again") from None


def read_done(folder: Path) -> dict[str, Any] | None:
    """The record of a finished step; None: it is not finished, or the record is damaged."""
    try:
        done = json.loads((folder / DONE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return done if isinstance(done, dict) and done.get("format") == FORMAT and {"figures", "seconds"} <= done.keys() else None
