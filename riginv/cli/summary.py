"""What a finished run reached, and what to do with it."""

from riginv.build import OURS
from riginv.cli.run_folder import BUNDLE, METRICS, POSES, RunFolder
from riginv.cli.tables import print_results, sets_of
from riginv.files import read_json


def show(folder: RunFolder) -> None:
    """Show what a finished run reached, and what to do with it."""
    metrics = read_json(folder.path / METRICS)
    steps, seconds = metrics["train/steps"], metrics["train/seconds"]
    more = " capture=TAKE.csv" if {"capture", "simulated_performance"} & set(sets_of(metrics)) else ""
    if folder.config["rig"]["_target_"].partition(".")[0] not in OURS:
        more += " rig=NAME --config-dir DIR"  # a bundle names no code of others: the user does
    print_results(
        metrics,
        f"{steps:,} steps in {seconds / 60:.1f} minutes",
        notes=[
            f"The trained model:  {folder.path / BUNDLE}",
            f"Its worst poses:    {folder.path / POSES}",
            f"Judge it again:     python -m riginv.evaluate bundle='{folder.path / BUNDLE}'{more}",
            f"Watch or compare:   tensorboard --logdir {folder.path.parent}",
        ],
    )
