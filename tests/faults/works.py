"""The commands that faults befall, and what they leave when nothing happens."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from tests.conftest import ROOT, SMALL
from tests.faults.contents import contents
from tests.faults.processes import Commands

TOY = ["rig=toy", f"--config-dir={ROOT / 'tests/conf'}"]
QUICK = ("model=forward",)  # a surrogate is trained sooner than an inverse
LONGER = ["trainer.max_steps=40", "data.steps_per_epoch=20", "checkpoint.every_n_steps=4", "pictures.final=true"]


@dataclass
class Work:
    """A command, in a folder that holds what it needs.

    Attributes:
        again: arguments more for a start after a fault.
        done: whether it need not be started again.
        needs: a folder whose files it needs in its own.
    """

    name: str
    arguments: Sequence[str]
    again: Sequence[str]
    done: Callable[[Path], bool]
    needs: Path | None = None

    def prepare(self, folder: Path) -> Path:
        folder.mkdir(exist_ok=True)
        if self.needs is not None:
            shutil.copytree(self.needs, folder, dirs_exist_ok=True)
        return folder

    def unbroken(self, commands: Commands, folder: Path) -> "Whole":
        """What it leaves when nothing happens."""
        done = commands.run(self.name, self.arguments, self.prepare(folder))
        assert done.code == 0, done.said
        return Whole(contents(folder), done.seconds, folder)


class Whole(NamedTuple):
    """What a command left when nothing happened: digests of its files, the seconds it took, and where they lie."""

    contents: dict[str, str]
    seconds: float
    folder: Path


def training(*more: str) -> Work:
    arguments = [*SMALL, *LONGER, "hydra.run.dir=run", *more]
    return Work("train", arguments, ["resume=true"], lambda folder: (folder / "run/metrics.json").exists())


def solving(clip: Path) -> Work:
    arguments = [*TOY, "clip=take.npz", "out=curves", "method=clip", "formats=[glb,anim,blender]", "look.sheet=false"]
    return Work("invert", arguments, [], lambda folder: (folder / "curves").exists(), clip)


def exporting(trained: Path) -> Work:
    return Work("export_onnx", [*TOY, "bundle=run", "out=inverse.onnx", "poses=5"], [], lambda folder: False, trained)


def sampling(jobs: int = 1) -> Work:
    arguments = [*TOY, "out=poses.zarr", "samples=12000", "chunk=500", "seed=3", f"jobs={jobs}"]
    return Work("sample", arguments, [], lambda folder: False)
