"""python -m riginv.learn_prior: which controls of a rig go together, learned from takes that were inverted before."""

from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.console import Console

from riginv.errors import InputError
from riginv.invert import free_folder
from riginv.launch.command import command
from riginv.runs.locks import exclusive_lock
from riginv.runs.run_folder import plain_config
from riginv.tracking.priors.files import save_prior
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import blended, learn_prior
from riginv.tracking.priors.takes import read_take
from riginv.training.assembly import build_rig

NAMED = 5  # controls that are named as the freest


def learn(config: DictConfig) -> None:
    """Learn a prior from `config.takes` and leave it as the folder `config.out`."""
    plain = plain_config(config)
    out, takes, fraction = free_folder(plain["out"]), plain["takes"], plain["fraction"]
    if not isinstance(takes, list) or not all(isinstance(take, str) for take in takes):
        raise InputError(f"takes is {takes!r}, expected a list of files: takes=[monday/curves.csv,live_link.csv]")
    if not isinstance(fraction, int | float) or isinstance(fraction, bool) or not 0 < fraction <= 1:
        raise InputError(f"fraction is {fraction!r}, expected a number above 0 and up to 1: of the takes in the prior")
    rig = build_rig(plain)
    with exclusive_lock(out):
        prior, frames = default_prior(rig), 0
        if takes:
            controls = torch.cat([read_take(Path(take), rig, plain["first"], plain["last"]) for take in takes])
            taken = learn_prior(rig, controls, ", ".join(Path(take).name for take in takes))
            prior, frames = blended(taken, prior, fraction), len(controls)
        save_prior(out, prior, rig, frames)
    freest = sorted(zip(prior.deviation.tolist(), prior.names), reverse=True)[:NAMED]
    names = ", ".join(f"{name} ({deviation:.2f})" for deviation, name in freest)
    console = Console()
    console.print(f"  {len(prior.names)} controls, {frames or 'no'} frames: {prior.source}", highlight=False, markup=False)
    console.print(f"  freest, by standard deviation in fractions of their ranges: {names}", highlight=False, markup=False)
    console.print(f"  {out}: riginv.invert takes it with prior={out}", highlight=False, markup=False)


if __name__ == "__main__":
    command("learn_prior")(learn)()
