"""A sweep as a table: a row for each job with its swept values, state and results."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from riginv.launch.sweep_record import FINISHED, JobRecord, read_records
from riginv.runs.files import read_json, write_text
from riginv.runs.run_folder import METRICS
from riginv.runs.tables import csv_text, markdown_text

CSV, MARKDOWN = "sweep.csv", "sweep.md"
ERROR = "/mean_vertex_error_mm"
FIRST = f"rig_poses{ERROR}"  # what rows are sorted by, where all have it
Row = dict[str, Any]


def sweep_rows(sweep: Path) -> list[Row]:
    """A row for each job: one column for each swept key, `state`, `took_seconds`, the metrics, `folder`, `host` and `why`.

    Jobs of one rig stand together, the least error first; what did not finish comes last.
    """
    rows = [_row(sweep, record) for record in read_records(sweep)]
    rigs = list(dict.fromkeys(row.get("rig") for row in rows))
    ranking = {rig: ranked_by([row for row in rows if row.get("rig") == rig]) for rig in rigs}

    def rank(row: Row) -> tuple[bool, int, float]:
        best = ranking[row.get("rig")]
        return row["state"] != FINISHED, rigs.index(row.get("rig")), math.inf if best is None else row.get(best, math.inf)

    return sorted(rows, key=rank)


def ranked_by(rows: Sequence[Row]) -> str | None:
    """The error that rows are sorted by: that on random poses of the rig, or else the first that all have; None: none."""
    errors = error_columns(rows)
    with_errors = [row for row in rows if any(key in row for key in errors)]
    shared = [key for key in errors if all(key in row for row in with_errors)]
    return FIRST if FIRST in shared else next(iter(shared), None)


def error_columns(rows: Sequence[Row]) -> list[str]:
    return [key for key in dict.fromkeys(key for row in rows for key in row) if key.endswith(ERROR)]


def swept_columns(rows: Sequence[Row]) -> list[str]:
    """The columns of swept keys: all before `state`."""
    keys = (key for row in rows for key in list(row)[: list(row).index("state")])
    return list(dict.fromkeys(keys))


def shown_columns(rows: Sequence[Row]) -> dict[str, str]:
    """The columns that are printed, each with its heading."""
    headings = {key: key.rpartition(".")[2] if key.count(".") else key for key in swept_columns(rows)}
    if len(set(headings.values())) < len(headings):
        headings = {key: key for key in headings}
    if any(row["state"] != FINISHED for row in rows):
        headings["state"] = "state"
    headings |= {key: key.removesuffix(ERROR).replace("_", " ") for key in error_columns(rows)}
    return {**headings, "took_seconds": "took s"}


def shown(value: Any) -> str:
    """The text of a cell."""
    if value is None or value == "":
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"
    return str(value)


def write_tables(sweep: Path, rows: Sequence[Row]) -> None:
    """Write the rows as `sweep.csv`, with every metric, and as `sweep.md`, for documents."""
    write_text(sweep / CSV, csv_text(list(dict.fromkeys(key for row in rows for key in row)), rows))
    headings, cells = shown_columns(rows), [[shown(row.get(key)) for key in shown_columns(rows)] for row in rows]
    table = markdown_text(list(headings.values()), cells, text_columns(rows))
    write_text(sweep / MARKDOWN, f"{table}\n{caption(rows)}\n")


def text_columns(rows: Sequence[Row]) -> list[int]:
    """The shown columns that hold words: those that were swept."""
    names = swept_columns(rows)
    return [number for number, key in enumerate(shown_columns(rows)) if key in names]


def caption(rows: Sequence[Row]) -> str:
    """The caption of the table: the meaning of its columns, and the order of its rows; empty without errors."""
    by = {ranked_by([row for row in rows if row.get("rig") == rig]): None for rig in (row.get("rig") for row in rows)}
    names = [key.removesuffix(ERROR).replace("_", " ") for key in by if key]
    sorting = f"; sorted by that on {' or '.join(names)}" if names else ""
    return f"Mean vertex error in mm on the true rig{sorting}." if error_columns(rows) else ""


def _row(sweep: Path, record: JobRecord) -> Row:
    apart = dict(text.lstrip("+~").split("=", 1) for text in record.swept if "=" in text) or {"job": record.name}
    file = sweep / record.name / METRICS
    metrics = read_json(file) if record.state == FINISHED and file.is_file() else {}
    metrics = {key: value for key, value in metrics.items() if not isinstance(value, list)}
    ended = {"folder": record.name, "host": record.host, "why": record.why}
    return {**apart, "state": record.state, "took_seconds": record.seconds, **metrics, **ended}
