"""Terminal output of a training: the progress bar, the table of the finished run, and the next commands."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lightning as L
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from riginv.config.building import OURS
from riginv.config.values import fits
from riginv.errors import InputError
from riginv.runs.files import read_json
from riginv.runs.run_folder import BUNDLE, METRICS, POSES, RunFolder
from riginv.runs.tables import COLUMNS, print_results, sets_of

TRAINING, ERROR = "train/rms_vertex_error_mm", "/mean_vertex_error_mm"
HIDDEN_SET = "random_combinations"  # not shown: the rig can make few of these meshes
UPDATE_STEPS = 10  # steps between two updates of the bar
PAIR = {"control": str, "instead": str, "frames": int, "fraction": float}
LISTS: dict[str, Any] = {
    "confused_controls": list[Mapping[str, str | float]],
    "controls_counted_as_one": list[list[str]],
    "controls_without_effect": list[str],
}


def show(folder: RunFolder, rig: str) -> None:
    """Print the results of a finished run and commands that use it.

    Args:
        rig: the name of the rig's class.
    """
    metrics = checked(folder.path / METRICS, read_json(folder.path / METRICS))
    steps, seconds = metrics["train/steps"], metrics["train/seconds"]
    clips = " capture=CLIP" if {"capture", "simulated_performance", "walk"} & set(sets_of(metrics)) else ""
    foreign = rig.partition(".")[0] not in OURS
    more = " rig=NAME --config-dir DIR" if foreign else ""  # a bundle names no code of others: the user does
    invert = f"riginv invert bundle='{folder.path / BUNDLE}' clip=CLIP out=DIR{more}"
    time = f"{seconds / 60:.1f} minutes" if seconds >= 60 else f"{seconds:.0f} seconds"
    print_results(
        metrics,
        f"{steps:,} steps in {time}",
        notes=[
            f"The trained model:  {folder.path / BUNDLE}",
            *([f"Its worst poses:    {folder.path / POSES}"] if (folder.path / POSES).exists() else []),
            *([f"Invert a clip:      {invert}"] if clips or "held_out_pairs" in sets_of(metrics) else []),
            f"Evaluate again:     riginv evaluate bundle='{folder.path / BUNDLE}'{clips}{more}",
            f"Watch or compare:   tensorboard --logdir {folder.path.parent}",
        ],
    )


def checked(path: Path, metrics: dict[str, Any]) -> dict[str, Any]:
    """The metrics of a finished run, checked.

    Raises:
        InputError: a figure is missing, or is no number.
    """
    needed = {"train/steps", "train/seconds", "true_rig"} | {f"{name}/{key}" for name in sets_of(metrics) for key, _ in COLUMNS}
    for key in sorted(needed | metrics.keys()):
        expected = str if key == "true_rig" else float if key in needed else LISTS.get(key.partition("/")[2], float | None)
        value = metrics.get(key)
        pairs: list[Any] = list(value or ()) if expected is LISTS["confused_controls"] and fits(value, expected) else []
        if not fits(value, expected) or not all(fits(pair.get(name), hint) for pair in pairs for name, hint in PAIR.items()):
            raise InputError(f"{path}: {key} is {value!r:.80}: altered; delete the file and use resume=true to evaluate again")
    return metrics


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
