"""Pictures of the worst and the median pose, in TensorBoard."""

from typing import cast

import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from PIL import Image

from riginv.meshes.rendering import Pair, comparison
from riginv.rig.batches import PoseBatch
from riginv.training.data import PoseDataModule
from riginv.training.module import RigModule


class PosePictures(L.Callback):
    """Shows, for each validation set, its worst and its median pose: what was asked for, what came out, and the error.

    Args:
        every_n_validations: how often; the last validation is always shown.
    """

    def __init__(self, every_n_validations: int) -> None:
        self.every_n_validations, self.validations = every_n_validations, 0

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        assert isinstance(module, RigModule) and isinstance(module.logger, TensorBoardLogger)
        self.validations += 1
        if self.validations % self.every_n_validations and trainer.global_step < trainer.max_steps:
            return
        data: PoseDataModule = trainer.datamodule  # type: ignore[attr-defined]  # set by fit
        for name, batch in data.validation.items():
            moved = {key: cast(torch.Tensor, values).to(module.device) for key, values in batch.items()}
            picture = worst_and_median(module, cast(PoseBatch, moved))
            module.logger.experiment.add_image(f"poses/{name}", np.asarray(picture), trainer.global_step, dataformats="HWC")


@torch.no_grad()
def worst_and_median(module: RigModule, batch: PoseBatch) -> Image.Image:
    """The worst and the median pose of a batch."""
    targets, results = module.rig.space.decode(batch["coordinates"]), module.results(batch)
    order = (results - targets).norm(dim=2).mean(dim=1).argsort(descending=True).tolist()
    rows = {"worst: target": order[0], "median: target": order[len(order) // 2]}
    return comparison(module.true_rig, [Pair(label, targets[row], results[row]) for label, row in rows.items()])
