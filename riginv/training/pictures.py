"""Pictures of the worst and the median pose, in TensorBoard."""

from typing import cast

import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from PIL import Image
from torch.utils.tensorboard import SummaryWriter

from riginv.meshes.rendering import Pair, comparison
from riginv.rig.batches import PoseBatch
from riginv.training.data import PoseDataModule
from riginv.training.module import RigModule


class PosePictures(L.Callback):
    """Shows, for each validation set, its worst and its median mesh: target, result and error.

    Args:
        every_n_validations: how often; the last validation is always shown.
    """

    def __init__(self, every_n_validations: int) -> None:
        self.every_n_validations, self.validations = every_n_validations, 0

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        assert isinstance(module, RigModule)
        self.validations += 1
        if self.validations % self.every_n_validations and trainer.global_step < trainer.max_steps:
            return
        for name, batch in validation_sets(trainer, module).items():
            picture = worst_and_median(module, batch)
            writer_of(trainer).add_image(f"poses/{name}", np.asarray(picture), trainer.global_step, dataformats="HWC")


def writer_of(trainer: L.Trainer) -> SummaryWriter:
    """The TensorBoard writer of a trainer."""
    assert isinstance(trainer.logger, TensorBoardLogger)
    return trainer.logger.experiment


def validation_sets(trainer: L.Trainer, module: RigModule) -> dict[str, PoseBatch]:
    """The validation sets of a training by name, each as one batch on the module's device."""
    data: PoseDataModule = trainer.datamodule  # type: ignore[attr-defined]  # set by fit
    return {
        name: cast(PoseBatch, {key: cast(torch.Tensor, values).to(module.device) for key, values in batch.items()})
        for name, batch in data.validation.items()
    }


@torch.no_grad()
def worst_and_median(module: RigModule, batch: PoseBatch) -> Image.Image:
    """The worst and the median pose of a batch."""
    targets, results = module.rig.space.decode(batch["coordinates"]), module.results(batch)
    order = (results - targets).norm(dim=2).mean(dim=1).argsort(descending=True).tolist()
    rows = {"worst: target": order[0], "median: target": order[len(order) // 2]}
    return comparison(module.true_rig, [Pair(label, targets[row], results[row]) for label, row in rows.items()])
