"""Segments of a GUI control: intervals of its range on which the table is linear."""

from dataclasses import dataclass

import numpy as np

from rigs.dna.format.layers import Conditions
from rigs.dna.logic.conditions import runs_of


@dataclass(frozen=True)
class Segments:
    """One GUI control.

    Attributes:
        gui: index of the control.
        rest: value at rest.
        outputs: indices of the raw controls that it affects, `(output,)`.
        ends: lower and upper end of each segment, `(segment, 2)`.
        slopes, cuts: contribution slope * x + cut to each output on each segment, `(segment, output)`.
    """

    gui: int
    rest: float
    outputs: np.ndarray
    ends: np.ndarray
    slopes: np.ndarray
    cuts: np.ndarray

    @property
    def range(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest contribution to each output, `(output,)` each."""
        values = np.concatenate([self.slopes * self.ends[:, :1] + self.cuts, self.slopes * self.ends[:, 1:] + self.cuts])
        return values.min(axis=0), values.max(axis=0)


def segments_of(table: Conditions, gui: int) -> Segments:
    """Segments of a GUI control that the table uses, with the exact numbers of the file."""
    runs = runs_of(table, len(table.inputs))
    rows = np.flatnonzero(table.inputs == gui)
    lower, upper = np.minimum(table.lower, table.upper).astype(float), np.maximum(table.lower, table.upper).astype(float)
    outputs = np.unique(table.outputs[rows]).astype(np.int64)
    breaks = np.unique(np.concatenate([lower[rows], upper[rows]]))
    rest = float(np.clip(0.0, breaks[0], breaks[-1]))
    between = np.stack([breaks[:-1], breaks[1:]], axis=1)
    ends = np.concatenate([between, np.stack([breaks, breaks], axis=1)])  # another row may apply at a break than on both sides
    slopes, cuts = np.zeros((len(ends), len(outputs))), np.zeros((len(ends), len(outputs)))
    for number, (start, end) in enumerate(ends):
        seen = set()
        for row in rows.tolist():
            if runs[row] not in seen and lower[row] <= start and end <= upper[row]:
                seen.add(runs[row])  # the first applicable row of a run
                column = int(np.searchsorted(outputs, table.outputs[row]))
                slopes[number, column] += table.slopes[row]
                cuts[number, column] += table.cuts[row]
    kept = np.ones(len(ends), bool)
    kept[len(between) :] = [
        not _continues(slopes, cuts, float(value), len(between) + number, [number - 1, number], len(between))
        for number, value in enumerate(breaks)
    ]
    return Segments(gui, rest, outputs, ends[kept], slopes[kept], cuts[kept])


def _continues(slopes: np.ndarray, cuts: np.ndarray, value: float, point: int, beside: list[int], count: int) -> bool:
    """Whether the values at a break continue one of the adjacent segments."""
    values = slopes * value + cuts
    return any(np.allclose(values[point], values[segment], rtol=0, atol=1e-7) for segment in beside if 0 <= segment < count)
