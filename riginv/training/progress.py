"""Progress bar of training, with errors in mm."""

from typing import Any

import lightning as L
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

TRAINING, ERROR = "train/rms_vertex_error_mm", "/mean_vertex_error_mm"
HIDDEN_SET = "random_combinations"  # not shown: the rig can make few of these meshes
UPDATE_STEPS = 10  # steps between two updates of the bar


class TrainingProgress(L.Callback):
    """One bar over all steps, with errors in mm; without a terminal, a line at each validation."""

    def __init__(self) -> None:
        self.console = Console()
        self.bar: Progress | None = None

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if not self.console.is_terminal or not trainer.is_global_zero:
            return
        time_columns = (TimeElapsedColumn(), TextColumn("<"), TimeRemainingColumn())
        columns = (BarColumn(24), MofNCompleteColumn(), *time_columns, TextColumn("{task.description}"))
        self.bar = Progress(*columns, console=self.console)
        self.bar.add_task("", total=trainer.max_steps if trainer.max_steps > 0 else None, completed=trainer.global_step)
        self.bar.start()

    def on_train_batch_end(self, trainer: L.Trainer, *args: Any) -> None:
        if self.bar is not None and trainer.global_step % UPDATE_STEPS == 0:
            self.bar.update(self.bar.task_ids[0], completed=trainer.global_step, description=errors_mm(trainer))

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if self.bar is None and trainer.is_global_zero and not trainer.sanity_checking:
            total = f"/{trainer.max_steps}" if trainer.max_steps > 0 else ""
            print(f"step {trainer.global_step}{total}  {errors_mm(trainer)}", flush=True)

    def on_train_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if self.bar is not None:
            self.bar.update(self.bar.task_ids[0], completed=trainer.global_step, description=errors_mm(trainer))
            self.bar.stop()
            self.bar = None

    def on_exception(self, trainer: L.Trainer, module: L.LightningModule, exception: BaseException) -> None:
        if self.bar is not None:
            self.bar.stop()
            self.bar = None


def errors_mm(trainer: L.Trainer) -> str:
    """The latest errors, such as `mm: training (rms) 0.84, rig poses 0.31`."""
    known = trainer.callback_metrics
    names = {key: key.split("/")[1].replace("_", " ") for key in known if key.endswith(ERROR) and HIDDEN_SET not in key}
    shown = [f"{name} {float(known[key]):.2f}" for key, name in {TRAINING: "training (rms)", **names}.items() if key in known]
    return f"mm: {', '.join(shown)}" if shown else ""
