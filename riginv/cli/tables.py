"""Results as tables that a newcomer understands."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

SETS = {
    "random_combinations": (
        "random combinations",
        "blendshapes combined at random, as in the paper: mostly out of the rig's reach",
    ),
    "rig_poses": ("rig poses", "random poses of the rig, as in the paper"),
    "capture": ("capture", "the clip that was given"),
    "simulated_performance": ("simulated performance", "no clip was given: capture=CLIP judges any that riginv.invert takes"),
    "held_out_pairs": ("held-out pairs", "recorded poses that training never saw"),
    "surrogate": ("surrogate", "the surrogate alone on the controls of those poses: how far it can be believed"),
    "walk": ("walk", "the walk that the rig brings, for no clip was given: capture=CLIP judges any that riginv.invert takes"),
    "rig_agreement": ("rig agreement", "both rigs on the same random controls"),
}
WITHIN_REACH_MM = 0.005  # a least error below this: the rig can make these meshes
NO_RIG = "none"  # as the true rig, where poses that were recorded of it are all there is
COLUMNS = (
    ("mean_vertex_error_mm", "mean\nerror"),
    ("neutral_mean_vertex_error_mm", "neutral's\nerror"),
    ("mean_of_max_vertex_error_mm", "worst\nvertex"),
    ("max_vertex_error_mm", "of\nall"),
)


def print_results(metrics: Mapping[str, Any], title: str, notes: Sequence[str] = ()) -> None:
    """Show a model's metrics, one row for each test set, and who judged: its `true_rig`."""
    table = Table(
        title=f"{escape(title)}: vertex errors in mm",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("judged on", no_wrap=True)
    for _, heading in COLUMNS:
        table.add_column(heading, justify="right")
    table.add_column("share\nleft", justify="right")
    table.add_column("times\nbest", justify="right")
    table.add_column("rough-\nness", justify="right")
    for name in sets_of(metrics):
        values = [metrics[f"{name}/{key}"] for key, _ in COLUMNS]
        rough = metrics.get(f"{name}/roughness")
        share = f"{values[0] / max(values[1], 1e-12):.0%}"
        shown = [f"{value:.2f}" if value >= 0.1 else f"{value:.2g}" for value in values]
        table.add_row(
            SETS.get(name, (name,))[0],
            *shown,
            share,
            _times_best(metrics, name),
            "-" if rough is None else f"{rough:.1e}",
        )
    console = Console()
    console.print(table)
    for name in sets_of(metrics):
        title, meaning = SETS.get(name, (name, ""))
        console.print(f"  [bold]{escape(title)}[/]: {meaning}", highlight=False, soft_wrap=True)
    judge = f"Judged by the true rig, [bold]{escape(metrics['true_rig'])}[/], which was given the controls."
    if metrics["true_rig"] == NO_RIG:
        judge = "No rig was at hand to judge: poses that training never saw did, and a [bold]surrogate[/] made the meshes."
    console.print(f"  {judge}", highlight=False, soft_wrap=True)
    console.print(
        "  Neutral's error: what predicting the neutral mesh would cost; share left: of that. "
        "Worst vertex: on average over the meshes, and of all. "
        "Times best: the error over the least that a solver found from many starts, on a few of the meshes; of 0: none at all. "
        "Roughness: mean squared second difference of the curves.",
        highlight=False,
        soft_wrap=True,
    )
    console.print()
    for note in notes:
        console.print(f"  {note}", soft_wrap=True, highlight=False, markup=False)


def print_notes(notes: Sequence[str]) -> None:
    """Show what was guessed, mended or left out as a clip was read, one line each."""
    console = Console(stderr=True)
    for note in notes:
        console.print(f"note: {note}", highlight=False, soft_wrap=True, markup=False)


def _times_best(metrics: Mapping[str, Any], name: str) -> str:
    """How many times the best possible error; of nothing there is no multiple."""
    ratio, best = (metrics.get(f"{name}/{key}") for key in ("optimum_ratio", "optimum_mean_vertex_error_mm"))
    return "-" if ratio is None else "of 0" if best < WITHIN_REACH_MM else f"{ratio:.3g}"


def sets_of(metrics: Mapping[str, float]) -> list[str]:
    """The names of the test sets in metrics, in their order."""
    return [key.partition("/")[0] for key in metrics if key.endswith("/mean_vertex_error_mm")]
