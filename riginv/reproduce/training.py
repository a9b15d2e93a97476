"""The step that trains a network."""

from dataclasses import dataclass
from pathlib import Path

from riginv.config.aliases import upgraded
from riginv.config.typed import to_plain
from riginv.errors import InputError
from riginv.reproduce.recipes import through_surrogate
from riginv.reproduce.rigs import rig_in_space, trained_rig
from riginv.reproduce.sets import spread_subset
from riginv.reproduce.steps import Figures, Task, Workspace
from riginv.runs.files import discard
from riginv.runs.locks import unlock_folder
from riginv.runs.run_folder import BUNDLE, RunFolder, find_run_folder
from riginv.train import fit_network
from riginv.training.config import TrainConfig

RUN = "run"


@dataclass(frozen=True)
class TrainNetwork(Task):
    """Train a network, through a trained rig if `surrogate` is among the inputs; interrupted training resumes.

    Writes `run/`: the folder of a run without checkpoints.
    """

    training: TrainConfig

    def run(self, at: Workspace) -> Figures:
        training = self.training
        rig = programmatic = rig_in_space(self.rig)
        if "surrogate" in at.inputs:
            bundle = str(bundle_of(at.inputs["surrogate"]))
            rig, training = trained_rig(bundle, rig), through_surrogate(training, bundle)
        folder = _run_folder(at.folder / RUN, training)
        validation = spread_subset(programmatic.source, at.context.capture, training.evaluation.validation_poses)
        try:
            _, facts = fit_network(training, folder, rig, programmatic.source, validation)
        finally:
            unlock_folder(folder.path)
        discard(folder.path / "checkpoints")
        return facts


def bundle_of(folder: str) -> Path:
    """The bundle in the folder of a training step."""
    return Path(folder) / RUN / BUNDLE


def _run_folder(path: Path, training: TrainConfig) -> RunFolder:
    config = to_plain(training)
    try:
        return find_run_folder(path, config, resume=True, upgrade=upgraded)
    except InputError:  # incomplete, or from before the reproduction was moved
        discard(path)
        return find_run_folder(path, config, resume=True)
