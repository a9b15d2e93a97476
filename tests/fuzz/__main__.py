"""python -m tests.fuzz [--cases N] [--seed S] [--only TEXT]: damage every kind of file, read it, and print the tally."""

import argparse
import contextlib
import io
import os
import sys
import tempfile
import time
from pathlib import Path

import pytest
from rich import box
from rich.console import Console
from rich.table import Table

from tests.fuzz.readers import IN_PROCESSES, READERS
from tests.fuzz.tally import Tally, survive

SHARE = 50  # of the cases for readers that cost processes


def main() -> int:
    """Print a table; 1 where anything crashed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=2000, help="damaged files of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="readers whose names hold this")
    given = parser.parse_args()
    tallies, console, began = [], Console(), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="riginv-fuzz-") as place:
        os.environ["RIGINV_CACHE"] = f"{place}/cache"
        for number, name in enumerate(name for name in READERS if given.only in name):
            folder = Path(place) / str(number)
            folder.mkdir()
            cases = max(1, given.cases // SHARE) if name in IN_PROCESSES else given.cases
            try:
                with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                    tallies.append(survive(name, READERS[name](folder), cases, given.seed))
            except pytest.skip.Exception as reason:
                console.print(f"{name}: {reason}", markup=False, highlight=False)
                continue
            for crash in tallies[-1].crashes[:3]:
                console.print(f"{name}: {crash}", markup=False, highlight=False)
    console.print(table_of(tallies))
    console.print(f"seed {given.seed}, {time.monotonic() - began:.0f} s", highlight=False)
    return int(any(tally.crashes for tally in tallies))


def table_of(tallies: list[Tally]) -> Table:
    """One row for each reader, and their sum."""
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("reader", "cases", "refused", "read", "crashes"):
        table.add_column(heading, justify="left" if heading == "reader" else "right")
    rows = [(one.name, one.cases, one.refused, one.read, len(one.crashes)) for one in tallies]
    for name, *counts in [*rows, ("all", *(sum(row[place] for row in rows) for place in range(1, 5)))]:
        table.add_row(name, *(f"{count:,}" for count in counts))
    return table


if __name__ == "__main__":
    sys.exit(main())
