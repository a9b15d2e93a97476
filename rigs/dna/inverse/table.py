"""Inverse of a file's GUI table."""

from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from rigs.dna.format import DnaFile
from rigs.dna.format.layers import Behavior, Definition
from rigs.dna.inverse.segments import Segments, segments_of
from rigs.dna.inverse.several import SharedOutputs
from rigs.dna.inverse.single import SAME, best_value
from rigs.dna.logic.conditions import ConditionTable, input_ranges
from rigs.dna.logic.layout import Layout

REACHED = 1e-6  # error of a component that needs no further search
MOST_ROWS = 500  # of the table, for one GUI control
SWEEPS = 20  # of coordinate descent over the controls of a component


class GuiAnswer(NamedTuple):
    """GUI controls for raw controls.

    Attributes:
        gui: `(frame, gui)`, within limits; at rest where they have no effect.
        residual: raw controls of the table minus the given ones, clamped to [0, 1], `(frame, raw)`.
    """

    gui: np.ndarray
    residual: np.ndarray


class TableInverse:
    """GUI controls whose raw controls have the least sum of absolute differences from given ones.

    GUI controls without common outputs are solved one by one in closed form; others by coordinate descent from rest, and by a
    mixed-integer program where that does not reach the raw controls exactly.

    Args:
        file: the file.

    Raises:
        InputError: its table is damaged.
    """

    def __init__(self, file: DnaFile) -> None:
        table, layout = file.need(Behavior).controls.table, Layout.of(file)
        self.forward = ConditionTable(layout, "the GUI table", table, len(table.inputs), layout.gui, layout.raw)
        lower, upper = input_ranges(table, layout.gui)
        self.rest = np.where(np.isnan(lower), 0.0, np.clip(0.0, lower, upper))
        rows = np.bincount(table.inputs, minlength=1)
        if rows.max() > MOST_ROWS:
            name = file.need(Definition).gui_controls[int(rows.argmax())]
            raise layout.wrong(f"GUI control {name[:60]!r} has {rows.max():,} rows in the table, more than could be meant")
        controls = [segments_of(table, number) for number in np.flatnonzero(upper > lower).tolist()]
        self.components = _components(controls, layout.raw)

    def __call__(self, raw: np.ndarray) -> GuiAnswer:
        """GUI controls for raw controls `(frame, raw)`."""
        target = np.clip(np.asarray(raw, dtype=np.float64), 0, 1)
        gui = np.repeat(self.rest[None], len(target), axis=0)
        inside: list[tuple[Segments, np.ndarray]] = []
        for controls in self.components:
            values, segments = self._solve(controls, target)
            for number, control in enumerate(controls):
                gui[:, control.gui] = values[:, number]
                inside.append((control, segments[:, number]))
        gui = self._off_the_edges(gui, inside, target)
        return GuiAnswer(gui, self._table(gui) - target)

    def _solve(self, controls: list[Segments], target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and segments `(frame, control)` of the controls of a component."""
        if len(controls) == 1:
            value, segment, _ = best_value(controls[0], np.zeros(1), target[:, controls[0].outputs])
            return value[:, None], segment[:, None]
        outputs = np.unique(np.concatenate([control.outputs for control in controls]))
        values = np.repeat([[control.rest for control in controls]], len(target), axis=0)
        segments = np.zeros(values.shape, np.int64)
        for number, control in enumerate(controls):
            segments[:, number] = _segment_at(control, control.rest)
        for _ in range(SWEEPS):
            before = values.copy()
            for number, control in enumerate(controls):
                rest = self._sums(controls, outputs, values, segments, without=number)
                rows = np.searchsorted(outputs, control.outputs)
                values[:, number], segments[:, number], _ = best_value(control, rest[:, rows], target[:, control.outputs])
            if np.abs(values - before).max(initial=0.0) < SAME:
                break
        errors = _errors(self._sums(controls, outputs, values, segments), target[:, outputs])
        program = SharedOutputs(controls, outputs)
        for frame in np.flatnonzero(errors > REACHED).tolist():
            solution = program.solve(target[frame, outputs])
            if solution is not None:
                self._take_better(controls, outputs, target[frame : frame + 1, outputs], values, segments, frame, solution)
        return values, segments

    def _take_better(
        self,
        controls: list[Segments],
        outputs: np.ndarray,
        target: np.ndarray,
        values: np.ndarray,
        segments: np.ndarray,
        frame: int,
        found: tuple[list[float], list[int]],
    ) -> None:
        """Polish the solution of the program for a frame and store it where it is better than the present one."""
        value, segment = np.array([found[0]]), np.array([found[1]])
        tried = [(values[frame : frame + 1].copy(), segments[frame : frame + 1].copy()), (value, segment)]
        matrix = np.zeros((len(outputs), len(controls)))
        for number, control in enumerate(controls):
            matrix[np.searchsorted(outputs, control.outputs), number] = control.slopes[segment[0, number]]
        free = (target[0] > 0) & (target[0] < 1)
        remaining = (target - self._sums(controls, outputs, value, segment))[0]
        ends = np.array([control.ends[number] for control, number in zip(controls, found[1])])
        better = np.clip(value + np.linalg.lstsq(matrix[free], remaining[free], rcond=None)[0], ends[:, 0], ends[:, 1])
        tried.append((better, segment))
        errors = [float(_errors(self._sums(controls, outputs, *one), target)[0]) for one in tried]
        values[frame], segments[frame] = (part[0] for part in tried[int(np.argmin(errors))])

    def _sums(
        self,
        controls: list[Segments],
        outputs: np.ndarray,
        values: np.ndarray,
        segments: np.ndarray,
        without: int | None = None,
    ) -> np.ndarray:
        """Unclamped sum of the contributions of the controls, `(frame, output)`; `without` one of them."""
        total = np.zeros((len(values), len(outputs)))
        for number, control in enumerate(controls):
            if number != without:
                segment = segments[:, number]
                added = control.slopes[segment] * values[:, number, None] + control.cuts[segment]
                total[:, np.searchsorted(outputs, control.outputs)] += added
        return total

    def _off_the_edges(self, gui: np.ndarray, inside: list[tuple[Segments, np.ndarray]], target: np.ndarray) -> np.ndarray:
        """Move values on the edge of their segment into it by one float32, where the table is discontinuous."""
        for control, segment in inside:
            if len(control.ends) == 1:
                continue
            middle = control.ends[segment].mean(axis=1)
            value = gui[:, control.gui]
            moved = gui.copy()
            moved[:, control.gui] = np.nextafter(value.astype(np.float32), middle.astype(np.float32))
            worse, better = (np.abs(self._table(one) - target)[:, control.outputs].sum(axis=1) for one in (gui, moved))
            gui = np.where((better < worse - REACHED)[:, None], moved, gui)
        return gui

    def _table(self, gui: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return self.forward(torch.as_tensor(gui, dtype=torch.float64)).numpy()


def _errors(sums: np.ndarray, target: np.ndarray) -> np.ndarray:
    return np.abs(np.clip(sums, 0, 1) - target).sum(axis=1)


def _segment_at(control: Segments, value: float) -> int:
    return int(np.argmax((control.ends[:, 0] <= value) & (value <= control.ends[:, 1])))


def _components(controls: list[Segments], outputs: int) -> list[list[Segments]]:
    """Connected components of GUI controls with common outputs."""
    counts = [len(control.outputs) for control in controls]
    columns = np.concatenate([control.outputs for control in controls] or [np.zeros(0)]).astype(np.int64)
    rows = np.repeat(np.arange(len(controls)), counts)
    writes = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(controls), outputs))
    _, labels = connected_components(writes @ writes.T, directed=False)
    return [[controls[number] for number in np.flatnonzero(labels == label)] for label in np.unique(labels)]
