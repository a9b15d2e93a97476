"""Summaries of stores, for their metadata and for the terminal."""

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from riginv.runs.tables import new_table
from riginv.sampling.store.layout import CONTROL_RANGE, COST, ERRORS
from riginv.sampling.store.store import PoseStore


def range_seen(store: PoseStore) -> dict[str, list[float]]:
    """Least and greatest value of each control over all chunks."""
    seen = store.per_chunk(CONTROL_RANGE)
    least, greatest = seen[:, 0].min(axis=0).tolist(), seen[:, 1].max(axis=0).tolist()
    names = [control["name"] for control in store.facts["rig"]["controls"]]
    return {name: list(ends) for name, ends in zip(names, zip(least, greatest))}


def storage_errors(store: PoseStore) -> dict[str, float]:
    """Errors of storage over all chunks, by the kinds of `ERRORS`."""
    values, counts = store.per_chunk(COST), store.ledger()[0][:, 0].astype(float)
    found = {}
    for kind, column in zip(ERRORS, values.T):
        if "greatest" in kind:
            found[kind] = float(column.max())
        elif kind == "outside_mean_mm":
            found[kind] = float(np.sqrt((counts * column.astype(float) ** 2).sum() / counts.sum()))
        else:
            found[kind] = float((counts * column).sum() / counts.sum())
    return found


def finish(store: PoseStore) -> None:
    """Mark a complete store as finished, with the range of each control and the errors of storage."""
    store.remove_partial_files()
    summary = {"finished": True, "range_seen": range_seen(store), "errors": storage_errors(store)}
    if any(store.group.attrs.get(key) != value for key, value in summary.items()):
        store.note(**summary)


def table(store: PoseStore, rows: dict[str, Any]) -> Table:
    """Table of a store with additional rows."""
    layout, rig = store.layout, store.facts["rig"]
    found = new_table(["", ""], str(store), text_columns=(0, 1))
    found.columns[0].no_wrap = True
    arrays = f"{layout.controls} controls, {layout.coefficients} coefficients"
    found.add_row("poses", f"{layout.samples:,} of rig '{rig['name']}': {arrays}{', vertices' if layout.vertices else ''}")
    found.add_row("chunks", f"{layout.chunks:,} of {layout.chunk:,} poses, {layout.dtype}, seed {store.facts['seed']}")
    for what, value in rows.items():
        found.add_row(what, value)
    return found


def findings(store: PoseStore) -> dict[str, str]:
    """Rows for `table` about a finished store: the range of the controls, and the errors of storage."""
    seen, errors = range_seen(store), storage_errors(store)
    fractions = {
        control["name"]: (seen[control["name"]][1] - seen[control["name"]][0]) / (control["upper"] - control["lower"])
        for control in store.facts["rig"]["controls"]
    }
    least = min(fractions, key=fractions.__getitem__)
    rows = {"controls seen": f"each over at least {fractions[least]:.0%} of its range ('{least}' the least)"}
    if store.layout.dtype != "float32":
        rows["rounding"] = (
            f"coefficients: greatest {errors['coefficient_greatest']:.2g}, mean {errors['coefficient_mean']:.2g}; "
            f"their meshes: greatest {errors['mesh_greatest_mm']:.2g} mm, mean {errors['mesh_mean_mm']:.2g} mm"
        )
        if store.layout.vertices:
            rows["rounding"] += (
                f"; vertices: greatest {errors['vertices_greatest_mm']:.2g} mm, mean {errors['vertices_mean_mm']:.2g} mm"
            )
    if store.layout.fitted:
        rows["outside the basis"] = f"{errors['outside_mean_mm']:.2g} mm, root mean square"
    return rows


def show(store: PoseStore, rows: dict[str, str]) -> None:
    Console().print(table(store, rows), highlight=False)
