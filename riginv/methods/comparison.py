"""Methods side by side: kept one by one as they finish, shown as tables and as a plot."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

from riginv.config.values import fits
from riginv.errors import InputError
from riginv.methods.evaluation import ACCURACY
from riginv.runs.console import Bar
from riginv.runs.files import atomic_write, read_json, write_json, write_text
from riginv.runs.run_folder import METRICS
from riginv.runs.tables import BOUND, CONTROLS_LEGEND, EXACT, WITHIN_REACH_MM, csv_text, markdown_text, new_table

CSV, MARKDOWN, PLOT, METHODS = "compare.csv", "compare.md", "compare.png", "methods"
HEADINGS = {
    "method": "method",
    "set": "test set",
    "mean_vertex_error_mm": "mean\nmm",
    "max_vertex_error_mm": "worst\nmm",
    "roughness": "rough-\nness",
    "nonzero_controls": "controls\nin use",
    "ms_per_frame": "ms a\nframe",
    "training_seconds": "train-\ning s",
    "optimum_ratio": "times\noptimum",
    "control_precision": "preci-\nsion",
    "control_recall": "re-\ncall",
    "control_error_weighted": "control\nerror",
}
LATER = (*ACCURACY, "optimum_is_bound")  # earlier versions did not write them
MAY_BE_MISSING = ("roughness", "optimum_ratio", "optimum_mm", *LATER)
ROW = {
    **dict.fromkeys((*HEADINGS, "optimum_mm"), float),
    **dict.fromkeys(MAY_BE_MISSING, float | None),
    **dict.fromkeys(("method", "set"), str),
}
Rows = list[dict[str, Any]]


def keep_rows(folder: Path, name: str, facts: Mapping[str, Any], rows: Rows) -> None:
    """Store the results of a method, with all that they depend on, such as its config."""
    write_json(folder / METHODS / f"{name}.json", {**facts, "rows": rows})


def kept_rows(folder: Path, name: str, facts: Mapping[str, Any]) -> Rows | None:
    """The stored results of a method, or None where it has not finished or they depend on something else."""
    path = folder / METHODS / f"{name}.json"
    if not path.is_file():
        return None
    try:
        kept = read_kept(path)
    except InputError:  # damaged: it is run again
        return None
    return kept["rows"] if all(kept.get(key) == value for key, value in facts.items()) else None


def read_kept(path: Path) -> dict[str, Any]:
    """The content of a file that `keep_rows` wrote.

    Raises:
        InputError: it is damaged.
    """
    kept = read_json(path)
    found = kept.get("rows") or []
    are_rows = fits(kept.get("source"), str) and fits(found, list[Mapping[str, Any]])
    rows = [{**dict.fromkeys(LATER), **row} for row in found] if are_rows else []
    whole = rows and all(key in row and fits(row[key], hint) for row in rows for key, hint in ROW.items())
    if not whole or any(row["optimum_mm"] is None and row["optimum_ratio"] is not None for row in rows):
        raise InputError(f"{path}: altered since a method wrote it; remove it, and the method is run again")
    return {**kept, "rows": rows}


def write_tables(folder: Path) -> Rows:
    """Write the rows of all methods that the folder holds as CSV, as Markdown with each method's source, and as a plot."""
    files = sorted((folder / METHODS).glob("*.json"), key=lambda path: path.stat().st_mtime_ns)
    kept = {path.stem: read_kept(path) for path in files}
    rows = [row for one in kept.values() for row in one["rows"]]
    write_text(folder / CSV, csv_text(list(HEADINGS), rows))
    write_text(folder / MARKDOWN, _markdown(rows, {name: one["source"] for name, one in kept.items()}))
    with atomic_write(folder / PLOT) as beside:
        _plot(rows).savefig(beside, format="png", dpi=130)
    error = "mean_vertex_error_mm"
    write_json(folder / METRICS, {f"{row['method']} {row['set']}/{error}": row[error] for row in rows})
    return rows


def show(rows: Rows, folder: Path, left_out: Mapping[str, str]) -> None:
    """Show the rows in the terminal, one table for each set, and why methods were left out, by name."""
    console = Console()
    if not console.is_terminal:
        console.width = max(console.width, 110)  # a log: no column is folded
    for name in dict.fromkeys(row["set"] for row in rows):
        table = new_table([heading for key, heading in HEADINGS.items() if key != "set"], name.replace("_", " "))
        table.columns[0].no_wrap, table.show_edge = True, False
        for row in rows:
            if row["set"] == name:
                table.add_row(*(_shown(row, key) for key in HEADINGS if key != "set"))
        console.print(table, "")
    console.print(
        "  Vertex errors on the true rig at the predicted controls. Roughness: mean squared second difference "
        "of the curves. Controls in use: how many are not at neutral, averaged over the meshes. Times optimum: the error "
        "over the least that Levenberg-Marquardt found from many starts, on a few of the meshes; "
        f"{EXACT}: that least is below {WITHIN_REACH_MM:g} mm, the rig can make these meshes; {BOUND.strip()}: for rigs with a "
        f"fitted basis that least is an upper bound. {CONTROLS_LEGEND}",
        highlight=False,
        soft_wrap=True,
    )
    for name, reason in left_out.items():
        console.print(f"  Left out: {name}, for {reason}.", soft_wrap=True, highlight=False, markup=False)
    for what, file in (("figures", CSV), ("a table to paste", MARKDOWN), ("error and roughness", PLOT)):
        console.print(f"  {what}: {folder / file}", soft_wrap=True, highlight=False, markup=False)


def _shown(row: dict[str, Any], key: str) -> str:
    value = row[key]
    if value is None or isinstance(value, str):
        return value or "-"
    if key == "optimum_ratio" and row["optimum_mm"] < WITHIN_REACH_MM:
        return EXACT
    if key == "roughness":
        return f"{value:.1e}"
    least = BOUND if key == "optimum_ratio" and row["optimum_is_bound"] else ""
    return least + (f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 1e-3 else "0")


def _markdown(rows: Rows, sources: Mapping[str, str]) -> str:
    cells = [[_shown(row, key) for key in HEADINGS] for row in rows]
    notes = "".join(f"- **{name}**: {source}\n" for name, source in sources.items())
    return f"{markdown_text(list(HEADINGS.values()), cells, (0, 1))}\n{notes}"


def _plot(rows: Rows) -> Figure:
    """Error against roughness on the clip; against the time a frame takes where there is no clip. Lower left is better."""
    clip = [row for row in rows if row["roughness"] is not None]
    shown = clip or [row for row in rows if row["set"] == rows[0]["set"]]
    key = "roughness" if clip else "ms_per_frame"
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for number, row in enumerate(sorted(shown, key=lambda row: (row["mean_vertex_error_mm"], row[key]))):
        place = (row[key], row["mean_vertex_error_mm"])
        axes.scatter(*place, s=45)
        offset = (6, 5) if number % 2 else (6, -12)  # of two that lie side by side, one above and one below
        axes.annotate(row["method"].replace("_", " "), place, xytext=offset, textcoords="offset points", fontsize=9)
    axes.margins(x=0.15, y=0.1)
    axes.set_xscale("symlog" if any(row[key] <= 0 for row in shown) else "log", **_linear_below(shown, key))
    axes.set_yscale("log")
    axes.set_xlabel("roughness (mean squared second difference of the controls)" if clip else "ms per frame")
    axes.set_ylabel("mean vertex error, mm")
    axes.set_title(f"{shown[0]['set'].replace('_', ' ')}: lower left is better")
    axes.grid(alpha=0.3)
    return figure


def _linear_below(rows: Rows, key: str) -> dict[str, float]:
    """The value below which a logarithmic axis that must show 0 is linear."""
    positive = [row[key] for row in rows if row[key] > 0]
    return {"linthresh": min(positive, default=1.0)} if len(positive) < len(rows) else {}


class ComparisonProgress(Bar):
    """A progress bar over methods; without a terminal only a line for each finished method is printed."""

    def __init__(self, methods: int) -> None:
        super().__init__(BarColumn(24), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        self.task = self.bar.add_task("", total=methods)

    def at(self, method: str, what: str) -> None:
        """Show what a method works on: a set, or its preparation."""
        self.bar.update(self.task, description=f"{method}: {what}")

    def finished(self, method: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Show that a method has finished all sets."""
        errors = ", ".join(f"{row['set'].replace('_', ' ')} {row['mean_vertex_error_mm']:.3g}" for row in rows)
        self.bar.console.print(f"{method}: {errors} mm", soft_wrap=True, highlight=False)
        self.bar.advance(self.task)
