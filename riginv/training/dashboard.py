"""TensorBoard: a page of charts to watch, the choices of a run as few columns, its results, and pictures of poses."""

import re
from typing import Any, cast

import lightning as L
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from PIL import Image
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from riginv.launch.sweep_hparams import NAMED_COLUMNS, RESULT
from riginv.meshes.rendering import Pair, comparison
from riginv.rig.batches import PoseBatch
from riginv.runs.tables import sets_of
from riginv.training.data import PoseDataModule
from riginv.training.module import RigModule

MEAN, NEUTRAL, OPTIMUM = (f"{name}mean_vertex_error_mm" for name in ("", "neutral_", "optimum_"))
Layout = dict[str, dict[str, list[Any]]]


class Dashboard(L.Callback):
    """The page CUSTOM SCALARS: errors of each validation set beside neutral's and the optimum, loss, learning rate."""

    def __init__(self) -> None:
        self.neutral_mm: dict[str, float] = {}

    @rank_zero_only
    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        assert isinstance(module, RigModule)
        self.neutral_mm = neutral_errors(trainer, module)
        writer_of(trainer).add_custom_scalars(layout(list(self.neutral_mm)))
        self._log_neutral(trainer)

    @rank_zero_only
    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._log_neutral(trainer)

    def _log_neutral(self, trainer: L.Trainer) -> None:
        for name, error in self.neutral_mm.items():
            writer_of(trainer).add_scalar(f"val/{name}/{NEUTRAL}", error, trainer.global_step)


def layout(names: list[str]) -> Layout:
    """TensorBoard's layout of charts for the validation sets `names`; tags in it are regular expressions."""
    sets = {
        f"{name.replace('_', ' ')}: mean error, mm": [
            "Multiline",
            [f"^val/{re.escape(name)}/{key}$" for key in (MEAN, NEUTRAL, OPTIMUM)],
        ]
        for name in names
    }
    training = {
        "loss": ["Multiline", ["^train/loss$", "^train/epoch_loss$"]],
        "root mean square error, mm": ["Multiline", ["^train/rms_vertex_error_mm$"]],
        "learning rate": ["Multiline", ["^lr-"]],
    }
    return {"Validation, against neutral and the optimum": sets, "Training": training}


@torch.no_grad()
def neutral_errors(trainer: L.Trainer, module: RigModule) -> dict[str, float]:
    """The mean vertex error of neutral controls on each validation set, mm."""
    space = module.rig.space
    return {
        name: float((space.decode(batch["coordinates"]) - space.rest_vertices).norm(dim=2).mean())
        for name, batch in validation_sets(trainer, module).items()
    }


@rank_zero_only
def log_choices(trainer: L.Trainer, config: dict[str, Any]) -> None:
    """Log a plain config: all of it to hparams.yaml, the named columns and what the command line set to HPARAMS."""
    choices = _flat(config)
    assert trainer.logger is not None
    trainer.logger.log_hyperparams(choices)
    typed = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    keys = {*NAMED_COLUMNS, *(override.lstrip("+").partition("=")[0] for override in typed)}
    _, begun, ended = hparams({key: choices[key] for key in choices if key in keys}, {})
    for summary in (begun, ended):  # without the first of the three, which would fix the columns by this run alone
        writer_of(trainer).file_writer.add_summary(summary)  # type: ignore[attr-defined]  # torch annotates it as None


def log_results(trainer: L.Trainer, metrics: dict[str, float]) -> None:
    """Log every final metric, and the optimum of each set as a line through its chart."""
    writer, names = writer_of(trainer), sets_of(metrics)
    for key, value in metrics.items():
        if key.split("/")[0] in names and not isinstance(value, list):
            writer.add_scalar(f"{RESULT}/{key}", value, trainer.global_step)
    for name in names:
        if (optimum := metrics.get(f"{name}/{OPTIMUM}")) is not None:
            for step in (0, trainer.global_step):
                writer.add_scalar(f"val/{name}/{OPTIMUM}", optimum, step)
    writer.flush()


def _flat(config: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value if isinstance(value, bool | int | float | str) else str(value)
    return flat


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
