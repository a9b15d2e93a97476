"""The table at the end of a sweep."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from riginv.launch.sweep_record import FAILED, FAILURE, FINISHED, JOBS
from riginv.launch.sweep_rows import (
    CSV,
    MARKDOWN,
    Row,
    caption,
    error_columns,
    shown,
    shown_columns,
    sweep_rows,
    text_columns,
    write_tables,
)
from riginv.runs.tables import new_table

COLOURS = {FINISHED: "green", FAILED: "red"}


class SweepTable(Callback):
    """Callback after a multirun: prints a row for each job, writes `sweep.csv` and `sweep.md`; exits with 1 on failure."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        folder = Path(config.hydra.sweep.dir)
        rows = sweep_rows(folder)
        try:
            write_tables(folder, rows)
            from riginv.launch.sweep_hparams import write_columns  # tensorboard; Hydra loads this file for every command

            write_columns(folder, [row["folder"] for row in rows if row["state"] == FINISHED], error_columns(rows))
        except OSError as error:  # Hydra would warn, and end as if all were well
            Console(stderr=True).print(f"[bold red]error:[/] the table cannot be written: {escape(str(error))}", soft_wrap=True)
            sys.exit(1)
        _show(rows, folder)
        missing = [row for row in rows if row["state"] != FINISHED]
        if missing:
            _say_what_failed(missing, len(rows), folder, f"riginv.{config.hydra.job.config_name}")
            sys.exit(1)


def _show(rows: Sequence[Row], folder: Path) -> None:
    headings, best = shown_columns(rows), _best(rows)
    table = new_table(list(headings.values()), text_columns=text_columns(rows))
    for number, row in enumerate(rows):
        cells = [escape(shown(row.get(key))) for key in headings]
        styled = [f"[bold]{cell}[/]" if (number, key) in best else cell for key, cell in zip(headings, cells)]
        colour = COLOURS.get(row["state"], "yellow")
        table.add_row(*(f"[{colour}]{cell}[/]" if key == "state" else cell for key, cell in zip(headings, styled)))
    console = Console()
    console.print(table)
    for text in (caption(rows), f"All figures: {folder / CSV}; to paste: {folder / MARKDOWN}"):
        if text:
            console.print(f"  {escape(text)}", soft_wrap=True, highlight=False)
    if error_columns(rows):
        console.print(f"  Compare: tensorboard --logdir {escape(str(folder))}, HPARAMS", soft_wrap=True, highlight=False)


def _best(rows: Sequence[Row]) -> set[tuple[int, str]]:
    """The least error of each column, among the jobs of one rig."""
    best = set()
    for key in error_columns(rows):
        for rig in {row.get("rig") for row in rows}:
            errors = {number: row[key] for number, row in enumerate(rows) if row.get("rig") == rig and row.get(key) is not None}
            if len(errors) > 1:
                best.add((min(errors, key=errors.__getitem__), key))
    return best


def _say_what_failed(missing: Sequence[Row], count: int, folder: Path, module: str) -> None:
    console = Console(stderr=True)
    for row in missing:
        console.print(f"  {escape(row['folder'])}: {escape(row['why'] or row['state'])}", soft_wrap=True, highlight=False)
    where = f"the reasons are in {FAILURE} in their folders, their output is in {JOBS}/"
    again = f"python -m {module} -m resume=true hydra.sweep.dir='{folder}'"
    console.print(
        f"[bold red]error:[/] {len(missing)} of {count} jobs failed; {where}. To run these again: {escape(again)}",
        soft_wrap=True,
        highlight=False,
    )
