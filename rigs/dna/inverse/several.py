"""Optimal values of several GUI controls with common outputs, by a mixed-integer program for each frame."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from rigs.dna.inverse.segments import Segments


class SharedOutputs:
    """GUI controls with common outputs.

    Each control is on one of its segments: a binary variable for each, and a value that is 0 on the others. Two more binary
    variables mark outputs that are clamped below or above. The sum of the errors of the outputs is minimised (HiGHS).

    Args:
        controls: the GUI controls.
        outputs: all of their outputs, `(output,)`.
    """

    def __init__(self, controls: Sequence[Segments], outputs: np.ndarray) -> None:
        self.controls, self.outputs = controls, outputs
        self.sizes = [len(control.ends) for control in controls]
        segments, count = sum(self.sizes), len(outputs)
        slopes, cuts = np.zeros((count, segments)), np.zeros((count, segments))
        lowest, highest = np.zeros(count), np.zeros(count)
        first = np.cumsum([0, *self.sizes])
        for number, control in enumerate(controls):
            rows, columns = np.searchsorted(outputs, control.outputs), slice(first[number], first[number + 1])
            slopes[rows, columns], cuts[rows, columns] = control.slopes.T, control.cuts.T
            lowest[rows] += control.range[0]
            highest[rows] += control.range[1]
        self.segments, self.count = segments, count
        self.sums = np.concatenate([slopes, cuts], axis=1)  # (output, values and binaries of the segments)
        self.lowest, self.highest = np.minimum(lowest, 0.0), np.maximum(highest, 1.0)
        self.ends = np.concatenate([control.ends for control in controls])

    def solve(self, target: np.ndarray) -> tuple[list[float], list[int]] | None:
        """Value and segment of each control for target outputs `(output,)`; None where the solver fails."""
        segments, count = self.segments, self.count
        variables = 2 * segments + 3 * count  # values, segments; error, below, above of each output
        rows: list[dict[int, float]] = []
        lows: list[float] = []
        highs: list[float] = []

        def add(entries: dict[int, float], low: float, high: float) -> None:
            rows.append(entries)
            lows.append(low)
            highs.append(high)

        for segment, (start, end) in enumerate(self.ends):
            add({segment: 1.0, segments + segment: -start}, 0.0, np.inf)
            add({segment: 1.0, segments + segment: -end}, -np.inf, 0.0)
        first = 0
        for size in self.sizes:
            add({segments + segment: 1.0 for segment in range(first, first + size)}, 1.0, 1.0)
            first += size
        for output in range(count):
            total = {number: value for number, value in enumerate(self.sums[output]) if value}
            error, below, above = (2 * segments + kind * count + output for kind in range(3))
            low, high, goal = self.lowest[output], self.highest[output], target[output]
            add({**total, error: 1.0, below: 1.0 - low}, goal, np.inf)  # error >= target - sum, except where sum < 0
            add({error: 1.0, below: -goal}, 0.0, np.inf)  # there it is the target
            add({**total, below: high}, -np.inf, high)  # sum <= 0 where below
            add({**total, error: -1.0, above: -high}, -np.inf, goal)  # error >= sum - target, except where sum > 1
            add({error: 1.0, above: -(1 - goal)}, 0.0, np.inf)  # there it is 1 - target
            add({**total, above: low - 1.0}, low, np.inf)  # sum >= 1 where above
        matrix = csr_array(
            (
                [value for row in rows for value in row.values()],
                ([number for number, row in enumerate(rows) for _ in row], [column for row in rows for column in row]),
            ),
            shape=(len(rows), variables),
        )
        cost = np.zeros(variables)
        cost[2 * segments : 2 * segments + count] = 1.0
        binary = np.zeros(variables)
        binary[segments : 2 * segments] = binary[2 * segments + count :] = 1
        lower, upper = np.zeros(variables), np.ones(variables)
        lower[:segments], upper[:segments] = np.minimum(self.ends[:, 0], 0.0), np.maximum(self.ends[:, 1], 0.0)
        upper[2 * segments : 2 * segments + count] = np.inf
        program = milp(cost, integrality=binary, bounds=Bounds(lower, upper), constraints=LinearConstraint(matrix, lows, highs))
        if program.x is None:
            return None
        values, chosen, first = [], [], 0
        for size in self.sizes:
            segment = first + int(program.x[segments + first : segments + first + size].argmax())
            values.append(float(np.clip(program.x[segment], *self.ends[segment])))
            chosen.append(segment - first)
            first += size
        return values, chosen
