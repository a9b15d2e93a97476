"""The step that trains a network."""

from pathlib import Path
from typing import Any

from riginv.config.aliases import upgraded
from riginv.config.typed import to_typed
from riginv.errors import InputError
from riginv.reproduce.cast import rig_in_space, trained_rig
from riginv.reproduce.sets import captured
from riginv.reproduce.steps import Task
from riginv.runs.files import discard
from riginv.runs.locks import unlock_folder
from riginv.runs.run_folder import BUNDLE, RunFolder, find_run_folder
from riginv.train import fit_network
from riginv.training.config import TrainConfig

RUN = "run"


def train(task: Task) -> dict[str, Any]:
    """Train a network, through a trained rig where one is among the inputs; what was stopped goes on at its checkpoint.

    Leaves `run/`, a run's folder without its checkpoint: the bundle, and TensorBoard's events.
    """
    config = dict(task.config["training"])
    rig = programmatic = rig_in_space(task.config["rig"])
    if "surrogate" in task.inputs:
        bundle = str(bundle_of(task.inputs["surrogate"]))
        rig, config["rig"] = trained_rig(bundle, rig), {**config["rig"], "bundle": bundle}
    folder = _folder(task.folder / RUN, config)
    watched = captured(programmatic.rig, task.places, config["judging"]["validation_poses"])
    try:
        _, facts = fit_network(to_typed(config, TrainConfig), folder, rig, programmatic.rig, watched)
    finally:
        unlock_folder(folder.path)
    discard(folder.path / "checkpoints")
    return facts


def bundle_of(folder: str) -> Path:
    """The bundle that a training step left in its folder."""
    return Path(folder) / RUN / BUNDLE


def _folder(path: Path, config: dict[str, Any]) -> RunFolder:
    try:
        return find_run_folder(path, config, resume=True, upgrade=upgraded)
    except InputError:  # half-written, or begun before the folder was moved: begun anew
        discard(path)
        return find_run_folder(path, config, resume=True, upgrade=upgraded)
