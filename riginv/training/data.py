"""Lightning data module: training batches drawn from a sampler, and fixed validation sets."""

from collections.abc import Callable, Iterator
from typing import Any, cast

import lightning as L
import torch
from torch.utils.data import DataLoader, Dataset, IterableDataset

from riginv.errors import InputError
from riginv.rig.batches import PoseBatch, seed_at, split_batch
from riginv.sampling.meshes import MeshSampler
from riginv.training.cuda_graphs import GraphedDraw


class StepIndices(IterableDataset):
    """The indices of the remaining steps of this epoch; each batch is a function of its step index.

    So a resumed run continues with the batches that an unbroken run would have drawn.
    """

    def __init__(self, steps_per_epoch: int, current_step: Callable[[], int]) -> None:
        self.steps_per_epoch, self.current_step = steps_per_epoch, current_step

    def __len__(self) -> int:
        return self.steps_per_epoch

    def __iter__(self) -> Iterator[int]:
        step = self.current_step()
        return iter(range(step, (step // self.steps_per_epoch + 1) * self.steps_per_epoch))


class PoseDataModule(L.LightningDataModule):
    """Draws each training batch from the sampler with a generator seeded by (seed, step).

    With several processes each draws the whole batch and keeps its rows, so that batches do not depend on their number.

    Args:
        sampler: what to train on.
        validation: validation sets by name, each as one batch in mesh coordinates.
        batch_size: meshes in a training batch, those of all processes together.
        steps_per_epoch: training steps between two validations.
        seed: of the training batches.
        uses_graphs: whether drawing on a GPU is captured once as a CUDA graph and replayed.

    Raises:
        InputError: a size is below 1.
    """

    def __init__(
        self,
        sampler: MeshSampler,
        validation: dict[str, PoseBatch],
        batch_size: int,
        steps_per_epoch: int,
        seed: int,
        uses_graphs: bool = False,
    ) -> None:
        super().__init__()
        for name, value in (("batch_size", batch_size), ("steps_per_epoch", steps_per_epoch)):
            if value < 1:
                raise InputError(f"data.{name} is {value}, expected at least 1")
        self.sampler, self.validation = sampler, validation
        self.batch_size, self.steps_per_epoch, self.seed = batch_size, steps_per_epoch, seed
        self.uses_graphs, self._graphed = uses_graphs, cast(GraphedDraw | None, None)
        self._device: torch.device | None = None
        self._step, self._ahead = -1, cast(tuple[int, PoseBatch | None], (-1, None))  # the last step, and one that is drawn

    @property
    def attached_trainer(self) -> L.Trainer:
        """The trainer, once it has the data."""
        assert self.trainer is not None
        return self.trainer

    @property
    def validation_names(self) -> list[str]:
        return list(self.validation)

    def train_dataloader(self) -> DataLoader:
        return DataLoader(StepIndices(self.steps_per_epoch, lambda: self.attached_trainer.global_step), batch_size=None)

    def val_dataloader(self) -> list[DataLoader]:
        size = -(-self.batch_size // self.attached_trainer.world_size)
        parts = [_rows_of(poses, self.rows) for poses in self.validation.values()]
        return [DataLoader(cast(Dataset, split_batch(poses, size)), batch_size=None) for poses in parts]

    def on_after_batch_transfer(self, batch: torch.Tensor | PoseBatch, dataloader_idx: int) -> PoseBatch:
        if isinstance(batch, dict):
            return batch
        self._step, (step, drawn), self._ahead = int(batch), self._ahead, (-1, None)
        return drawn if drawn is not None and step == self._step else self._drawn(self._step)

    def draw_ahead(self) -> None:
        """Draw the batch of the next step, if there is one: by a thread that has nothing else to do."""
        following = self._step + 1
        if following != self.attached_trainer.max_steps:
            self._ahead = following, self._drawn(following)

    def _drawn(self, step: int) -> PoseBatch:
        self.sampler.at_step(step)
        device = self.attached_trainer.strategy.root_device
        if device != self._device:  # asked of every tensor, this takes a tenth of a draw
            self.sampler, self._device = self.sampler.to(device), device
        seed = seed_at(self.seed, "training", step, 0)
        if self.uses_graphs and device.type == "cuda":
            try:
                self._graphed = self._graphed or GraphedDraw(self._sample, device)
                return self._graphed(seed)
            except RuntimeError:  # stored poses are read by the CPU
                self.uses_graphs, self._graphed = False, None
        return self._sample(torch.Generator(device).manual_seed(seed))

    def _sample(self, generator: torch.Generator) -> PoseBatch:
        return self.sampler.sample_rows(self.batch_size, generator, self.rows)

    @property
    def rows(self) -> slice:
        """The rows of a batch for this process: every n-th of n processes, so that the parts of a mixture are spread evenly."""
        return slice(self.attached_trainer.global_rank, None, self.attached_trainer.world_size)


def _rows_of(poses: PoseBatch, rows: slice) -> PoseBatch:
    return cast(PoseBatch, {key: cast(torch.Tensor, values)[rows] for key, values in poses.items()})


def bare_trainer(**arguments: Any) -> L.Trainer:
    """A Lightning trainer without logs, checkpoints, progress bar and validation.

    Args:
        arguments: further arguments of `lightning.Trainer`.
    """
    return L.Trainer(
        max_epochs=-1,
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        enable_progress_bar=False,
        num_sanity_val_steps=0,
        limit_val_batches=0,
        **arguments,
    )
