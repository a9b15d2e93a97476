"""Tables: in the terminal, as CSV and as Markdown; and the table that a training or an evaluation ends in."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

SETS = {
    "random_combinations": (
        "random combinations",
        "blendshapes combined at random, as in the paper; the rig itself can make few of these meshes",
    ),
    "rig_poses": ("rig poses", "random poses of the rig, as in the paper"),
    "capture": ("capture", "the clip that was given"),
    "simulated_performance": ("simulated performance", "generated, as no clip was given (capture=CLIP)"),
    "held_out_pairs": ("held-out pairs", "recorded poses that training never saw"),
    "surrogate": ("surrogate", "the surrogate's own error on the same controls: a bound on the accuracy of the other rows"),
    "walk": ("walk", "the rig's own walk, as no clip was given (capture=CLIP)"),
    "rig_agreement": ("rig agreement", "both rigs on the same random controls"),
}
CONTROL_COLUMNS = (
    ("control_precision", "preci-\nsion"),
    ("control_recall", "recall"),
    ("control_error", "error"),
    ("control_error_weighted", "weighted\nerror"),
    ("control_correlation", "corre-\nlation"),
)
CONTROL_WORDS = {key: heading.replace("-\n", "").replace("\n", " ") for key, heading in CONTROL_COLUMNS}
SHOWN_PAIRS = 3
CONTROLS_LEGEND = (
    "Precision and recall: of active controls, more than 2 % of their range from neutral. Error: mean, in fractions of "
    "the range; weighted: by how far each control moves the mesh."
)
WITHIN_REACH_MM = 0.005  # a least error below this: the rig can make these meshes
EXACT = "exact"  # shown instead of the ratio to the optimum
BOUND = ">= "  # before a ratio to an upper bound of the optimum
NO_RIG = "none"  # the `true_rig` of a recorded rig in metrics.json
COLUMNS = (
    ("mean_vertex_error_mm", "mean\nerror"),
    ("neutral_mean_vertex_error_mm", "neutral\nerror"),
    ("mean_of_max_vertex_error_mm", "mesh\nworst"),
    ("max_vertex_error_mm", "all\nworst"),
)


def new_table(headings: Sequence[str], title: str = "", text_columns: Sequence[int] = (0,), padding: int = 1) -> Table:
    """A table for the terminal without rows.

    Args:
        headings: of the columns; empty: none is shown.
        title: plain text.
        text_columns: columns of words, aligned left; numbers are aligned right.
        padding: spaces between columns.
    """
    table = Table(title=escape(title) or None, box=box.SIMPLE_HEAD, show_header=any(headings), padding=(0, padding, 0, 0))
    table.title_justify, table.title_style = "left", "bold"
    for number, heading in enumerate(headings):
        table.add_column(escape(heading), justify="left" if number in text_columns else "right", overflow="fold")
    return table


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Rows as CSV; values of other keys than the columns are left out."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def markdown_text(headings: Sequence[str], rows: Iterable[Sequence[str]], text_columns: Sequence[int]) -> str:
    """Rows as a Markdown table; `text_columns` as of `new_table`."""
    rule = ["---" if number in text_columns else "---:" for number in range(len(headings))]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in [[heading.replace("\n", " ") for heading in headings], rule, *cells])


def print_results(metrics: Mapping[str, Any], title: str, notes: Sequence[str] = ()) -> None:
    """Print a model's metrics: one row for each evaluation set, and the true rig."""
    errors = [heading for _, heading in COLUMNS]
    headings = ["test set", *errors, "% of\nneutral", "times\noptimum", "rough-\nness"]
    table = new_table(headings, f"{title}: vertex errors in mm")
    table.show_edge, table.columns[0].no_wrap = False, True
    for name in sets_of(metrics):
        values = [metrics[f"{name}/{key}"] for key, _ in COLUMNS]
        rough = metrics.get(f"{name}/roughness")
        percent = f"{values[0] / max(values[1], 1e-12):.0%}"
        shown = [f"{value:.2f}" if value >= 0.1 else f"{value:.2g}" for value in values]
        table.add_row(
            SETS.get(name, (name,))[0],
            *shown,
            percent,
            _times_optimum(metrics, name),
            "-" if rough is None else f"{rough:.1e}",
        )
    console = Console()
    console.print(table, "")
    for name in sets_of(metrics):
        title, meaning = SETS.get(name, (name, ""))
        console.print(f"  [bold]{escape(title)}[/]: {meaning}", highlight=False, soft_wrap=True)
    judge = f"Evaluated on the true rig, [bold]{escape(metrics['true_rig'])}[/], posed with the predicted controls."
    if metrics["true_rig"] == NO_RIG:
        judge = "The rig is recorded: errors are on held-out poses, with a [bold]surrogate[/] as the rig."
    console.print(f"  {judge}", highlight=False, soft_wrap=True)
    console.print(
        "  Neutral error: the error of neutral controls; % of neutral: the mean error in percent of it. "
        "Mesh worst: the largest vertex error of a mesh, averaged over the meshes; all worst: the largest of all. "
        "Times optimum: the mean error over the least that a solver found from many starts, on a few of the meshes; "
        f"{EXACT}: that least is below {WITHIN_REACH_MM:g} mm, the rig can make these meshes; {BOUND.strip()}: for rigs with a "
        "fitted basis, the least that few solver steps reach. "
        "Roughness: mean squared second difference of the curves.",
        highlight=False,
        soft_wrap=True,
    )
    _print_controls(console, metrics)
    console.print()
    for note in notes:
        console.print(f"  {note}", soft_wrap=True, highlight=False, markup=False)


def _print_controls(console: Console, metrics: Mapping[str, Any]) -> None:
    """Show how near the controls are to the true ones, on the sets where these are known."""
    counts = ("active_controls", "true_active_controls")
    names = [name for name in sets_of(metrics) if all(metrics.get(f"{name}/{key}") is not None for key in counts)]
    if not names:
        return
    table = new_table(["test set", *(heading for _, heading in CONTROL_COLUMNS), "active\n(true)"], "Controls")
    table.show_edge, table.columns[0].no_wrap = False, True
    for name in names:
        values = [metrics.get(f"{name}/{key}") for key, _ in CONTROL_COLUMNS]
        shown = ["-" if value is None else f"{value:.3f}" for value in values]
        active, true = (metrics[f"{name}/{key}"] for key in counts)
        table.add_row(SETS.get(name, (name,))[0], *shown, f"{active:.1f} ({true:.1f})")
    console.print("", table, "")
    lines = [CONTROLS_LEGEND]
    for name in names:
        accuracy = {key.partition("/")[2]: value for key, value in metrics.items() if key.startswith(f"{name}/")}
        lines += pair_lines(accuracy, f" on {SETS.get(name, (name,))[0]}")
    for line in dict.fromkeys(lines):
        console.print(f"  {line}", highlight=False, soft_wrap=True, markup=False)


def control_lines(accuracy: Mapping[str, Any]) -> list[str]:
    """The accuracy of controls, by the names of metrics.json, in sentences for the user; none where it is empty."""
    if not accuracy:
        return []
    figures = [f"{name} {accuracy[key]:.3f}" for key, name in CONTROL_WORDS.items() if key in accuracy]
    return [
        f"Controls against the true ones of the clip: {', '.join(figures)} (errors in fractions of the range).",
        *pair_lines(accuracy),
    ]


def pair_lines(accuracy: Mapping[str, Any], where: str = "") -> list[str]:
    """The confused controls, and those that the mesh does not distinguish, in sentences for the user."""
    pairs = [
        f"{pair['instead']} in place of {pair['control']} ({pair['fraction']:.0%} of its missing value, in {pair['frames']} "
        "meshes)"
        for pair in (accuracy.get("confused_controls") or ())[:SHOWN_PAIRS]
    ]
    same, still = (accuracy.get(key) or () for key in ("controls_counted_as_one", "controls_without_effect"))
    return [
        *([f"Confused controls{where}: {'; '.join(pairs)}."] if pairs else []),
        *(
            [f"The mesh does not distinguish, counted as one: {'; '.join(' = '.join(group) for group in same)}."]
            if same
            else []
        ),
        *([f"Controls that move no vertex, not counted: {', '.join(still)}."] if still else []),
    ]


def _times_optimum(metrics: Mapping[str, Any], name: str) -> str:
    """The cell `times optimum`: a ratio, a lower bound of it, `exact`, or `-`."""
    ratio, best = (metrics.get(f"{name}/{key}") for key in ("optimum_ratio", "optimum_mean_vertex_error_mm"))
    if ratio is None or best is None:
        return "-"
    least = BOUND if metrics.get(f"{name}/optimum_is_bound") else ""
    return EXACT if best < WITHIN_REACH_MM else f"{least}{ratio:.3g}"


def sets_of(metrics: Mapping[str, float]) -> list[str]:
    """The names of the test sets in metrics, in their order."""
    return [key.partition("/")[0] for key in metrics if key.endswith("/mean_vertex_error_mm")]
