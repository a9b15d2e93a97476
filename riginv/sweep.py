"""The table at the end of a sweep."""

import csv
import json
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.console import Console
from rich.table import Table

from riginv.command import FAILURE
from riginv.errors import InputError
from riginv.files import written_beside
from riginv.run_folder import METRICS


class SweepTable(Callback):
    """After a multirun: one row for each job, in the terminal and as `sweep.csv`; fails where a job failed."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        folder = Path(config.hydra.sweep.dir)
        rows = [row_of(job) for job in sorted(path for path in folder.iterdir() if path.is_dir())]
        columns = list(dict.fromkeys(key for row in rows for key in row))
        with written_beside(folder / "sweep.csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(rows)
        _show(rows, folder)
        failed = [row["job"] for row in rows if row["state"] != "finished"]
        if failed:
            raise InputError(f"{len(failed)} of {len(rows)} jobs failed: {', '.join(failed)}; each says why in its {FAILURE}")


def row_of(job: Path) -> dict[str, Any]:
    """A job's row: its name, its state, and the metrics it reached."""
    if (job / METRICS).is_file():
        return {"job": job.name, "state": "finished", **json.loads((job / METRICS).read_text())}
    return {"job": job.name, "state": "failed"}


def _show(rows: list[dict[str, Any]], folder: Path) -> None:
    shown = [key for key in dict.fromkeys(key for row in rows for key in row) if key.endswith("/mean_vertex_error_mm")]
    shown += [key for key in ("train/steps", "train/seconds") if any(key in row for row in rows)]
    table = Table(title="Mean vertex error, mm", title_justify="left", title_style="bold")
    table.add_column("job", overflow="fold")
    for key in shown:
        table.add_column(key.removesuffix("/mean_vertex_error_mm").replace("_", " "), justify="right")
    for row in rows:
        name = row["job"] if row["state"] == "finished" else f"{row['job']} [red]failed[/]"
        table.add_row(name, *("-" if row.get(key) is None else f"{row[key]:.5g}" for key in shown))
    Console().print(table)
    Console().print(f"All figures: {folder / 'sweep.csv'}", soft_wrap=True, highlight=False)
