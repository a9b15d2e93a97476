"""A graph of steps, each kept in a folder named after all that it depends on."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from riginv.errors import InputError, in_short
from riginv.runs.files import write_json

FORMAT = 1  # of what a step leaves; another one is not read
DRAWING = ("draw", "plot")  # how the works begin that draw
DONE, LOG = "done.json", "log.txt"


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes:
        name: unique in a graph; words and dashes.
        work: what it does: a key of `riginv.reproduce.work.WORKS`.
        config: plain values that its result depends on.
        inputs: the steps whose folders it reads, by the name it reads them under.
        places: plain values that it needs and that its result does not depend on, such as the path of a file whose
            content stands in `config`.
        expected_s: what it is expected to take.
        about: a few words for progress lines.
    """

    name: str
    work: str
    config: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    places: Mapping[str, Any] = field(default_factory=dict)
    expected_s: float = 1.0
    about: str = ""


class Task(NamedTuple):
    """What a step is given.

    Attributes:
        config, places: the step's.
        inputs: the folders of the steps that it reads, by use.
        folder: its own.
    """

    config: Mapping[str, Any]
    places: Mapping[str, Any]
    inputs: Mapping[str, str]
    folder: Path


class Graph:
    """Steps in an order in which they can be run, and where each of them is kept.

    Args:
        steps: each after those that it reads.
        folder: that holds a folder for each of them.
        code: a key of the code that makes figures.
        drawing_code: a key of the code that draws them, which no other steps depend on.
    """

    def __init__(self, steps: Sequence[Step], folder: Path, code: str, drawing_code: str = "") -> None:
        self.steps = {step.name: step for step in steps}
        self.folder = folder
        self.keys: dict[str, str] = {}
        for step in steps:
            read = {use: self.keys[name] for use, name in step.inputs.items()}
            made_by = code + drawing_code if step.work.startswith(DRAWING) else code
            facts = json.dumps([FORMAT, made_by, step.work, step.config, read], sort_keys=True)
            self.keys[step.name] = hashlib.sha256(facts.encode()).hexdigest()[:12]

    def path(self, name: str) -> Path:
        """The folder of a step, NAME-KEY."""
        return self.folder / f"{name}-{self.keys[name]}"

    def inputs(self, name: str) -> dict[str, str]:
        """The folders that a step reads, by use."""
        return {use: str(self.path(other)) for use, other in self.steps[name].inputs.items()}

    def finished(self, name: str) -> bool:
        return read_done(self.path(name)) is not None

    def figures(self, name: str) -> dict[str, Any]:
        """The figures that a finished step gave."""
        return read_done(self.path(name))["figures"]

    def seconds(self, name: str) -> float:
        """What a finished step took, s."""
        return read_done(self.path(name))["seconds"]

    def stale_steps(self) -> list[str]:
        """Folders of steps that this graph does not know: of another version of the code, or of another config."""
        known = {self.path(name).name for name in self.steps}
        return sorted(path.name for path in self.folder.glob("*-*") if path.is_dir() and path.name not in known)


def write_done(folder: Path, seconds: float, figures: Mapping[str, Any]) -> None:
    """Mark a step as finished; written last."""
    write_json(folder / DONE, {"format": FORMAT, "seconds": round(seconds, 2), "figures": figures})


def read_tensors(path: Path) -> dict[str, Tensor]:
    """The tensors that a finished step left.

    Raises:
        InputError: they cannot be read.
    """
    try:
        return load_file(path)
    except (OSError, ValueError, KeyError, SafetensorError) as error:
        raise InputError(f"{path}: damaged ({in_short(error)}): remove its folder, and the step is run again") from None


def read_done(folder: Path) -> dict[str, Any] | None:
    """What a finished step left, or None where it is not finished, or what it left cannot be read."""
    try:
        done = json.loads((folder / DONE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return done if isinstance(done, dict) and done.get("format") == FORMAT and {"figures", "seconds"} <= done.keys() else None
