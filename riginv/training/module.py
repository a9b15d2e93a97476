"""Base class of the Lightning modules: optimiser and schedule, logging, NaN check, validation in mm."""

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from typing import Any, cast

import lightning as L
import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler, ReduceLROnPlateau
from torchmetrics import MeanMetric

from riginv.errors import InputError, NonFiniteLossError
from riginv.geometry.kernels.library import why_not
from riginv.meshes.vertex_error import VertexError
from riginv.networks.base import RigNetwork
from riginv.rig.batches import PoseBatch
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.threads import Workers, single_threaded
from riginv.training.cuda_graphs import GraphedStep
from riginv.training.data import PoseDataModule
from riginv.training.devices import all_reduce_means, check_normalisation, is_distributed
from riginv.training.losses import root_mean_square_mm
from riginv.training.parallel import can_be_halved, in_halves, worth_splitting

OptimizerFactory = Callable[[Iterable[nn.Parameter]], Optimizer]
ScheduleFactory = Callable[[Optimizer], LRScheduler | ReduceLROnPlateau]


class RigModule(L.LightningModule, ABC):
    """Trains one network on poses in mesh coordinates.

    Args:
        rig: the rig in mesh space, frozen.
        network: the network to train.
        make_optimizer: from parameters to an optimiser.
        make_schedule: from the optimiser to its schedule; a plateau schedule watches the training loss, epoch by epoch.

    Attributes:
        kind: of bundle that it makes: `inverse` (meshes to controls) or `forward` (a surrogate).
        true_rig: the rig that validation evaluates on; by default the rig itself.
        workers: threads that compute a step together; None: a step is computed by one.
        uses_graphs: whether a training step on a GPU is captured once as a CUDA graph and replayed.
        stop_below_lr: training ends once the schedule has brought the learning rate below this (paper: 1e-6); None: never.
    """

    kind = "inverse"
    rig: RigInMeshSpace
    network: RigNetwork
    loss: nn.Module
    true_rig: RigBackend
    stop_below_lr: float | None = None
    workers: Workers | None = None
    uses_graphs: bool = False

    def __init__(
        self, rig: RigInMeshSpace, network: RigNetwork, make_optimizer: OptimizerFactory, make_schedule: ScheduleFactory
    ) -> None:
        super().__init__()
        self.rig, self.network = rig.requires_grad_(False), network
        self.true_rig = rig.source
        self.make_optimizer, self.make_schedule = make_optimizer, make_schedule
        self.epoch_loss = MeanMetric(nan_strategy="ignore", sync_on_compute=False)  # gets means over all processes
        self.epoch_loss.persistent(True)  # so that a run stopped within an epoch still sees the whole of it
        self.errors: list[VertexError] = []
        self.graphed: GraphedStep | None = None

    @classmethod
    def can_train_on(cls, rig: LinearRig) -> bool:
        """Whether the module can be trained on a rig itself, and needs no surrogate of it."""
        return True

    @abstractmethod
    def loss_and_coordinates(self, batch: PoseBatch) -> tuple[Tensor, Tensor]:
        """The mean loss of a batch, and the predicted mesh coordinates `(batch, coordinate)`, detached."""

    @property
    def losses(self) -> list[nn.Module]:
        """The loss modules that `loss_and_coordinates` uses."""
        return [self.loss]

    def training_step(self, batch: PoseBatch, batch_idx: int) -> Tensor:
        weights = [weight for weight in self.network.parameters() if weight.requires_grad]
        if self.workers is not None and self.can_use_threads and worth_splitting(len(batch["coordinates"]), weights):
            loss, coordinates = self.loss_on_threads(batch, weights, self.workers)
        elif self.uses_graphs and self.device.type == "cuda" and self.can_use_threads:
            loss, coordinates = self.loss_on_graph(batch, weights)
        else:
            loss, coordinates = self.loss_and_coordinates(batch)
        return self.log_step(loss, coordinates, batch["coordinates"])

    def loss_on_threads(self, batch: PoseBatch, weights: list[nn.Parameter], workers: Workers) -> tuple[Tensor, Tensor]:
        """As `loss_and_coordinates`, computed by two threads, with the gradients of the weights."""
        return in_halves(self.loss_and_coordinates, batch, weights, workers)

    def loss_on_graph(self, batch: PoseBatch, weights: list[nn.Parameter]) -> tuple[Tensor, Tensor]:
        """As `loss_and_coordinates`, replayed from a CUDA graph, with the gradients of the weights."""
        try:
            if self.graphed is None:
                self.graphed = GraphedStep(self.loss_and_coordinates, batch, weights)
            if self.graphed.fits(batch):
                return self.graphed(batch)
        except RuntimeError as error:
            self.uses_graphs, self.graphed = False, None
            if self._trainer is None or self.trainer.is_global_zero:
                reason = str(error.__context__ or error).splitlines()[0]
                print(f"note: a training step is not replayed from a CUDA graph, so it is slower: {reason}", flush=True)
        return self.loss_and_coordinates(batch)

    def draw_ahead(self) -> None:
        """Draw the next batch, if a trainer has the data: by a thread that has nothing else to do."""
        data = None if self._trainer is None else self._trainer.datamodule  # type: ignore[attr-defined]  # set by fit
        if isinstance(data, PoseDataModule):
            data.draw_ahead()

    @functools.cached_property
    def can_use_threads(self) -> bool:
        """Whether `loss_on_threads` computes the same loss."""
        return can_be_halved(self.network, self.losses)

    def results(self, batch: PoseBatch) -> Tensor:
        """The predicted meshes `(batch, vertex, 3)`, mm: those of the true rig at an inverse's controls, or a surrogate's."""
        return self.true_rig(self.network(batch["coordinates"]))

    def setup(self, stage: str) -> None:
        if self.trainer.world_size > 1:
            check_normalisation(self.network, self.trainer.strategy.root_device)

    def on_train_start(self) -> None:
        if self.workers is not None and self.can_use_threads and self.device.type == "cpu" and self.trainer.is_global_zero:
            self.workers.update_count()
            missing = why_not()
            print(f"training on {self.workers.describe()}{f'; no compiled kernels: {missing}' if missing else ''}", flush=True)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Raises InputError where the checkpoint's tensors do not match the network's."""
        expected, stored = self.state_dict(), checkpoint["state_dict"]
        differing = sorted(
            str(name)
            for name in expected.keys() | stored.keys()
            if getattr(expected.get(name), "shape", None) != getattr(stored.get(name), "shape", None)
        )
        if differing:
            raise InputError(f"the checkpoint does not fit the network: {differing[0]:.80} differs; remove it to start over")

    def configure_optimizers(self) -> Any:
        optimizer = self.make_optimizer([weight for weight in self.network.parameters() if weight.requires_grad])
        schedule = self.make_schedule(optimizer)
        plateau = isinstance(schedule, ReduceLROnPlateau)
        how = {"interval": "epoch", "monitor": "train/epoch_loss"} if plateau else {"interval": "step"}
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, **how}}

    def optimizer_step(self, *args: Any, **kwargs: Any) -> None:
        """A step, each operation of it on one thread where `workers` share it: beside a busy process others are waited for."""
        with single_threaded() if self.workers is not None else nullcontext():
            super().optimizer_step(*args, **kwargs)

    def lr_scheduler_step(self, scheduler: LRScheduler | ReduceLROnPlateau, metric: Tensor | None) -> None:
        super().lr_scheduler_step(scheduler, metric)
        if self.stop_below_lr is not None and all(rate < self.stop_below_lr for rate in scheduler.get_last_lr()):
            self.trainer.should_stop = True

    def log_step(self, loss: Tensor, coordinates: Tensor, target: Tensor) -> Tensor:
        """Log a training step's loss and error, those of all processes together, and return the loss to learn from.

        Raises:
            NonFiniteLossError: the loss is NaN or infinite, in any process: all of them raise it.
        """
        logged, factor = loss.detach(), 1.0
        target = target[:, : coordinates.shape[1]]  # an inverse may see the leading ones alone
        error = root_mean_square_mm(coordinates, target, self.rig.space.vertex_count)
        if is_distributed():
            (logged, squared), factor = all_reduce_means(torch.stack([logged, error.square()]), len(target))
            error = squared.sqrt()
        if not torch.isfinite(logged):
            raise NonFiniteLossError(
                f"the loss became {logged.item()} at step {self.global_step}; the checkpoint holds the last good state saved "
                f"before: start a new run with a lower model.optimizer.lr"
            )
        self.epoch_loss.update(logged)
        if self.logs_step:
            self.log("train/loss", logged)
            self.log("train/rms_vertex_error_mm", error, prog_bar=True)
        return loss if factor == 1.0 else factor * loss

    @property
    def logs_step(self) -> bool:
        """Whether Lightning keeps what this training step logs: logging in the others as well takes a twentieth of a step."""
        trainer = self._trainer
        return trainer is None or trainer.is_last_batch or (trainer.global_step + 1) % trainer.log_every_n_steps == 0  # type: ignore[attr-defined]

    def on_train_epoch_end(self) -> None:
        self.log("train/epoch_loss", self.epoch_loss.compute())
        self.epoch_loss.reset()

    @property
    def validation_names(self) -> list[str]:
        return cast(PoseDataModule, self.trainer.datamodule).validation_names  # type: ignore[attr-defined]  # set by fit

    def on_validation_epoch_start(self) -> None:
        self.errors = [VertexError(of_all_processes=True).to(self.device) for _ in self.validation_names]

    def validation_step(self, batch: PoseBatch, batch_idx: int, dataloader_idx: int = 0) -> None:
        if not len(batch["coordinates"]):  # more processes than meshes
            return
        self.errors[dataloader_idx].update(self.results(batch), self.rig.space.decode(batch["coordinates"]))

    def on_validation_epoch_end(self) -> None:
        for name, error in zip(self.validation_names, self.errors):
            for key, value in error.compute().items():
                self.log(
                    f"val/{name}/{key}", value.float(), prog_bar=key.startswith("mean_v") and name != "random_combinations"
                )
