"""python -m riginv.learn_prior: a prior on a rig's controls, learned from earlier takes."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "learn_prior")  # before the imports that take seconds

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
from omegaconf import DictConfig
from rich.console import Console

from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig, to_typed
from riginv.config.values import Bound, NonNegativeInt
from riginv.rig.interface import RigBackend
from riginv.runs.console import show_lines
from riginv.runs.files import free_folder
from riginv.runs.locks import exclusive_lock
from riginv.runs.threads import single_threaded
from riginv.tracking.priors.files import save_prior
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import blended, learn_prior
from riginv.tracking.priors.takes import read_take, with_changes
from riginv.tracking.rigs import build_rig

LISTED = 5  # controls with the largest standard deviations

Takes = Annotated[Sequence[str], Bound("a list of files: takes=[monday/curves.csv,live_link.csv]", lambda value: True)]
TakeFraction = Annotated[float, Bound("a number above 0 and up to 1: of the takes in the prior", lambda value: 0 < value <= 1)]


@dataclass(frozen=True)
class LearnPriorConfig:
    """The config of `riginv.learn_prior`; conf/learn_prior.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    out: str
    takes: Takes
    first: NonNegativeInt | None
    last: NonNegativeInt | None
    fraction: TakeFraction
    mesh_space: MeshSpaceConfig


@single_threaded()  # operations are small
def learn(config: DictConfig) -> None:
    """Learn a prior from `config.takes` and write it as the folder `config.out`."""
    settings = to_typed(config, LearnPriorConfig)
    out = free_folder(settings.out)
    rig = build_rig(settings.rig, settings.mesh_space)
    with exclusive_lock(out):
        prior, frames = default_prior(rig), 0
        if settings.takes:
            takes = [read_take(Path(take), rig, settings.first, settings.last) for take in settings.takes]
            show_lines([], [f"{path}: {note}" for path, take in zip(settings.takes, takes) for note in take.notes])
            controls = torch.cat([take.controls for take in takes])
            learned = learn_prior(rig, controls, ", ".join(Path(take).name for take in settings.takes))
            prior, frames = with_changes(blended(learned, prior, settings.fraction), rig, takes), len(controls)
        save_prior(out, prior, rig, frames)
    freest = sorted(zip(prior.deviation.tolist(), prior.names), reverse=True)[:LISTED]
    names = ", ".join(f"{name} ({deviation:.2f})" for deviation, name in freest)
    lines = [
        f"  {len(prior.names)} controls, {frames or 'no'} frames: {prior.source}",
        f"  largest standard deviations, in fractions of the ranges: {names}",
        f"  {out}: riginv.invert takes it with prior={out}",
    ]
    show_lines(lines, console=Console())


if __name__ == "__main__":
    command("learn_prior")(learn)()
