"""Piecewise linear tables: from GUI controls to raw controls, and from controls to animated maps."""

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format.layers import Conditions
from rigs.dna.logic.layout import Layout, Stage


def runs_of(table: Conditions, rows: int) -> np.ndarray:
    """Index of the run of each of the first rows: consecutive rows with the same input and output."""
    inputs, outputs = table.inputs[:rows], table.outputs[:rows]
    starts = np.ones(rows, bool)
    starts[1:] = (np.diff(inputs.astype(np.int64)) != 0) | (np.diff(outputs.astype(np.int64)) != 0)
    return np.cumsum(starts) - 1


def check_table(layout: Layout, what: str, table: Conditions, inputs: int, outputs: int) -> None:
    """Check the indices and numbers of a table.

    Raises:
        InputError: something is out of range.
    """
    layout.check_lengths(
        what,
        inputs=len(table.inputs),
        outputs=len(table.outputs),
        lower=len(table.lower),
        upper=len(table.upper),
        slopes=len(table.slopes),
        cuts=len(table.cuts),
    )
    layout.check(f"the input of {what}", table.inputs, inputs, "inputs")
    layout.check(f"the output of {what}", table.outputs, outputs, "outputs")
    for name in ("lower", "upper", "slopes", "cuts"):
        layout.check_finite(f"{what}, {name}", getattr(table, name))


class ConditionTable(Stage):
    """Evaluates the first rows of a table.

    In each run the first row whose range contains the input applies, `slope * input + cut`; runs of one output are summed; the
    sum is clamped to [0, 1].

    Args:
        rows: number of rows that are used.
        outputs: number of outputs; those without rows are 0.

    Raises:
        InputError: the table is damaged.
    """

    run_inputs: Tensor
    run_outputs: Tensor
    lower: Tensor
    upper: Tensor
    slopes: Tensor
    cuts: Tensor

    def __init__(self, layout: Layout, what: str, table: Conditions, rows: int, inputs: int, outputs: int) -> None:
        super().__init__()
        check_table(layout, what, table, inputs, outputs)
        self.outputs = outputs
        run = runs_of(table, rows)
        sizes = np.bincount(run, minlength=int(run[-1]) + 1 if rows else 0)
        first = np.cumsum(sizes) - sizes
        slot = np.arange(rows) - first[run] if rows else np.zeros(0, np.int64)
        shape = (len(sizes), int(sizes.max(initial=1)))
        layout.check_room(what, *shape)
        padded = {name: np.zeros(shape) for name in ("slopes", "cuts")}
        padded |= {"lower": np.full(shape, np.inf), "upper": np.full(shape, -np.inf)}
        lower, upper = table.lower[:rows].astype(float), table.upper[:rows].astype(float)
        values = {"lower": np.minimum(lower, upper), "upper": np.maximum(lower, upper)}
        values |= {"slopes": table.slopes[:rows], "cuts": table.cuts[:rows]}
        for name, value in values.items():
            padded[name][run, slot] = value
        self.keep(run_inputs=table.inputs[first].astype(int), run_outputs=table.outputs[first].astype(int), **padded)

    def forward(self, inputs: Tensor) -> Tensor:
        """Inputs `(batch, input)` to outputs `(batch, output)`."""
        x = inputs.index_select(1, self.run_inputs)[..., None]
        holds = (x >= self.lower.to(inputs)) & (x <= self.upper.to(inputs))
        first = holds & (holds.cumsum(dim=2) == 1)
        values = torch.where(first, self.slopes.to(inputs) * x + self.cuts.to(inputs), 0.0).sum(dim=2)
        sums = inputs.new_zeros(len(inputs), self.outputs).index_add(1, self.run_outputs, values)
        return sums.clamp(0, 1)


def input_ranges(table: Conditions, inputs: int) -> tuple[np.ndarray, np.ndarray]:
    """Range of each input in which a row applies, `(input,)` each; NaN where no row uses it."""
    lower, upper = np.full(inputs, np.nan), np.full(inputs, np.nan)
    np.fmin.at(lower, table.inputs, np.minimum(table.lower, table.upper))
    np.fmax.at(upper, table.inputs, np.maximum(table.lower, table.upper))
    return lower, upper
