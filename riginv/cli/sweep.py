"""The table at the end of a sweep."""

import csv
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn
from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from riginv.cli.run_folder import METRICS
from riginv.files import read_json, write_text, written_beside

OVERRIDES = "overrides.txt"


class SweepTable(Callback):
    """After a multirun: one row for each job, in the terminal and as `sweep.csv`."""

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        if config.hydra.mode.name == "MULTIRUN":
            write_text(Path(config.hydra.runtime.output_dir) / OVERRIDES, "\n".join(job_return.overrides) + "\n")

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        folder = Path(config.hydra.sweep.dir)
        rows = sweep_rows(folder)
        columns = list(dict.fromkeys(key for row in rows for key in row))
        with written_beside(folder / "sweep.csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(rows)
        _show(rows, folder)


def sweep_rows(folder: Path) -> list[dict[str, Any]]:
    """A row for each job of a sweep, in the order they were started: what sets it apart, its state and its metrics."""
    jobs = sorted((path.parent for path in folder.glob(f"*/{OVERRIDES}")), key=lambda job: int(job.name.partition("_")[0]))
    overrides = [(job / OVERRIDES).read_text(encoding="utf-8").split("\n") for job in jobs]
    shared = set.intersection(*map(set, overrides)) if len(overrides) > 1 else set()
    rows = []
    for job, given in zip(jobs, overrides):
        finished = (job / METRICS).is_file()
        row = {"job": " ".join(text for text in given if text not in shared), "state": "finished" if finished else "failed"}
        metrics = read_json(job / METRICS) if finished else {}
        rows.append({**row, **metrics, "folder": job.name})
    return rows


def _show(rows: list[dict[str, Any]], folder: Path) -> None:
    keys = list(dict.fromkeys(key for row in rows for key in row))
    shown = [key for key in keys if key.endswith("/mean_vertex_error_mm")]
    shown += [key for key in ("train/steps", "train/seconds") if key in keys]
    table = Table(title="Mean vertex error, mm", title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    table.add_column("job", overflow="fold")
    for key in shown:
        table.add_column(key.removesuffix("/mean_vertex_error_mm").replace("_", " "), justify="right")
    for row in rows:
        job = escape(row["job"])
        name = job if row["state"] == "finished" else f"{job} [red]failed[/]"
        table.add_row(name, *("-" if row.get(key) is None else f"{row[key]:.5g}" for key in shown))
    Console().print(table)
    Console().print(f"All figures: {folder / 'sweep.csv'}", soft_wrap=True, highlight=False, markup=False)
