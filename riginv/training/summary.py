"""The table of a finished run, and the next commands."""

from pathlib import Path
from typing import Any

from riginv.config.building import OURS
from riginv.config.values import fits
from riginv.errors import InputError
from riginv.runs.files import read_json
from riginv.runs.run_folder import BUNDLE, METRICS, POSES, RunFolder
from riginv.runs.tables import COLUMNS, print_results, sets_of


def show(folder: RunFolder, rig: str) -> None:
    """Show what a finished run reached, and what to do with it.

    Args:
        rig: the name of the rig's class.
    """
    metrics = checked(folder.path / METRICS, read_json(folder.path / METRICS))
    steps, seconds = metrics["train/steps"], metrics["train/seconds"]
    more = " capture=CLIP" if {"capture", "simulated_performance"} & set(sets_of(metrics)) else ""
    if rig.partition(".")[0] not in OURS:
        more += " rig=NAME --config-dir DIR"  # a bundle names no code of others: the user does
    print_results(
        metrics,
        f"{steps:,} steps in {seconds / 60:.1f} minutes",
        notes=[
            f"The trained model:  {folder.path / BUNDLE}",
            f"Its worst poses:    {folder.path / POSES}",
            f"Evaluate again:     python -m riginv.evaluate bundle='{folder.path / BUNDLE}'{more}",
            f"Watch or compare:   tensorboard --logdir {folder.path.parent}",
        ],
    )


def checked(path: Path, metrics: dict[str, Any]) -> dict[str, Any]:
    """The metrics of a finished run, as they were written.

    Raises:
        InputError: a figure is missing, or is no number.
    """
    needed = {"train/steps", "train/seconds", "true_rig"} | {f"{name}/{key}" for name in sets_of(metrics) for key, _ in COLUMNS}
    for key in sorted(needed | metrics.keys()):
        expected = str if key == "true_rig" else float if key in needed else float | None
        if not fits(metrics.get(key), expected):
            raise InputError(
                f"{path}: {key} is {metrics.get(key)!r:.80}: altered; delete the file and use resume=true to evaluate again"
            )
    return metrics
