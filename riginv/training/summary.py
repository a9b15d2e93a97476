"""The table of a finished run, and the next commands."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from riginv.config.building import OURS
from riginv.config.values import fits
from riginv.errors import InputError
from riginv.runs.files import read_json
from riginv.runs.run_folder import BUNDLE, METRICS, POSES, RunFolder
from riginv.runs.tables import COLUMNS, print_results, sets_of

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
    more = " capture=CLIP" if {"capture", "simulated_performance"} & set(sets_of(metrics)) else ""
    if rig.partition(".")[0] not in OURS:
        more += " rig=NAME --config-dir DIR"  # a bundle names no code of others: the user does
    print_results(
        metrics,
        f"{steps:,} steps in {seconds / 60:.1f} minutes",
        notes=[
            f"The trained model:  {folder.path / BUNDLE}",
            *([f"Its worst poses:    {folder.path / POSES}"] if (folder.path / POSES).exists() else []),
            f"Evaluate again:     python -m riginv.evaluate bundle='{folder.path / BUNDLE}'{more}",
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
