"""Atomic checkpoints with checksums, and a clock of training time that is saved with them."""

import signal
import time
from pathlib import Path
from typing import Any

import lightning as L
import torch
from lightning.pytorch.plugins.io import TorchCheckpointIO

from riginv.errors import InputError, in_short
from riginv.runs.checksums import append_checksum
from riginv.runs.files import atomic_write, check_regular
from riginv.runs.run_folder import CHECKPOINT, CHECKPOINT_BEFORE

START_OVER = "remove it to start over"
PARTS = {
    **dict.fromkeys(("state_dict", "loops", "callbacks"), dict),
    **dict.fromkeys(("optimizer_states", "lr_schedulers"), list),
    **dict.fromkeys(("epoch", "global_step"), int),
}


class AtomicCheckpoints(TorchCheckpointIO):
    """Writes a checkpoint beside the last one, which is kept as the one before; reads without running code."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any | None = None) -> None:
        with atomic_write(Path(path)) as beside:
            with beside.open("wb") as file:  # given an open file, torch passes on OSError of a full disk
                torch.save(checkpoint, file)
            append_checksum(beside)
            if Path(path).is_file():
                Path(path).replace(Path(path).with_name(Path(CHECKPOINT_BEFORE).name))

    def load_checkpoint(self, path: str | Path, map_location: Any = None, weights_only: bool | None = None) -> dict[str, Any]:
        """Tensors and plain values.

        Raises:
            InputError: the file is damaged, no checkpoint, or holds anything else, which is never made.
        """
        check_regular(Path(path))
        try:
            checkpoint = torch.load(path, map_location=map_location or "cpu", weights_only=True)
        except Exception as error:  # torch.load raises exceptions of many types
            raise InputError(f"{path}: no checkpoint of plain tensors and values ({in_short(error)}); {START_OVER}") from None
        missing = [key for key in PARTS if not isinstance(checkpoint, dict) or not isinstance(checkpoint.get(key), PARTS[key])]
        if missing:
            raise InputError(f"{path}: no checkpoint of plain tensors and values (no {missing[0]} in it); {START_OVER}")
        return checkpoint


class SaveLast(L.Callback):
    """Saves a checkpoint every `every_n_steps` steps and at the end.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: Path, every_n_steps: int) -> None:
        self.folder, self.every_n_steps = folder, every_n_steps
        self.saved_step: int | None = None

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if trainer.world_size > 1:  # else Lightning waits for a collective that other ranks never enter
            signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def on_train_batch_end(self, trainer: L.Trainer, *args: Any) -> None:
        if trainer.global_step % self.every_n_steps == 0:
            self._save(trainer)

    def on_train_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._save(trainer)

    def on_exception(self, trainer: L.Trainer, module: L.LightningModule, exception: BaseException) -> None:
        if isinstance(exception, KeyboardInterrupt) and trainer.is_global_zero:
            saved = f"saved up to step {self.saved_step}" if self.saved_step else "nothing saved yet"
            exception.args = (f"at step {trainer.global_step}, {saved}; go on with the same command plus resume=true",)

    def _save(self, trainer: L.Trainer) -> None:
        if trainer.global_step != self.saved_step:
            trainer.save_checkpoint(self.folder / CHECKPOINT)
            self.saved_step = trainer.global_step


class TrainingClock(L.Callback):
    """Counts the seconds of training, including those before an interruption.

    Attributes:
        seconds: so far.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._since: float | None = None

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._since = time.monotonic()

    def on_train_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self.seconds, self._since = self._now(), None

    def state_dict(self) -> dict[str, float]:
        return {"seconds": self._now()}

    def load_state_dict(self, state: dict[str, float]) -> None:
        self.seconds = state["seconds"]

    def _now(self) -> float:
        return self.seconds + (time.monotonic() - self._since if self._since is not None else 0.0)
