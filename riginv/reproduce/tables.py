"""The paper's three tables as rows of plain values, from the figures of the steps; docs/reproduce.md explains the keys."""

import statistics
from collections.abc import Sequence
from typing import Any

from riginv.reproduce import measures as paper
from riginv.reproduce.plan import SETS, Plan
from riginv.reproduce.sets import CAPTURED, CLIP
from riginv.reproduce.steps import Graph
from riginv.reproduce.wording import MAX, MEAN

TableRow = dict[str, Any]
SMOOTHER = {"programmatic": ("inverse", "direct"), "trained": ("trained", "direct_trained")}  # rows, by rig
LABELS_3 = {"clip": "whole-clip solver", "optimum": "frame by frame, many starts"}


class Results:
    """The figures of a finished graph, by row.

    Args:
        clip_name: name of the clip in the tables.
    """

    def __init__(self, plan: Plan, graph: Graph, clip_name: str) -> None:
        self.plan, self.graph, self.clip_name = plan, graph, clip_name

    def of_inversion(self, row: str, key: str) -> list[float]:
        """A figure of the inversions of a row, for each seed; empty where there is none, as roughness without a clip."""
        return self._values(self.plan.rows[row].inversions, key)

    def errors(self, row: str, name: str, key: str = MEAN) -> list[float]:
        """An error of a row on a set, for each seed."""
        return self._values(self.plan.rows[row].evaluations, f"{name}/{key}")

    def mean(self, row: str, name: str, key: str = MEAN) -> float | None:
        """The mean over the seeds; None: there is no such row or set."""
        values = self.errors(row, name, key) if row in self.plan.rows else []
        return statistics.fmean(values) if values else None

    def smoothness_ratio(self, row: str, other: str) -> float | None:
        """Roughness of the other row over that of the row; None without a clip."""
        rough = [self.of_inversion(one, "roughness") for one in (row, other)]
        return statistics.fmean(rough[1]) / max(statistics.fmean(rough[0]), 1e-12) if all(rough) else None

    def rig_errors(self, trained: bool, key: str) -> list[float]:
        """Errors of the programmatic rig, or of each trained one, on the test poses."""
        names = [f"evaluate-surrogate-seed{seed}" for seed in self.plan.seeds] if trained else ["evaluate-programmatic"]
        return self._values(names, key)

    def one(self, step: str, key: str) -> float | None:
        """A figure of a step; None: there is no such step."""
        values = self._values([step], key) if step in self.graph.steps else []
        return values[0] if values else None

    def _values(self, steps: Sequence[str], key: str) -> list[float]:
        found = [self.graph.figures(step).get(key) for step in steps]
        return [value for value in found if value is not None]


def table_1(results: Results) -> list[TableRow]:
    """Rigs against the true rig on the test poses."""
    labels = {"programmatic": "programmatic rig", "trained": "trained rig"}
    rows = []
    for row, label in labels.items():
        trained = row == "trained"
        figures = {key: results.rig_errors(trained, key) for key in (MEAN, MAX)}
        rows.append(_row(row, label, results.plan.seeds if trained else [], figures) | _paper(paper.TABLE_1.get(row)))
    return rows


def table_2(results: Results) -> list[TableRow]:
    """Inverses against the inverted meshes, set by set."""
    rows = []
    for name in SETS:
        for row in ("inverse", "trained", "holden", "best", "optimum", "neutral"):
            figures = {key: results.errors(row, name, key) for key in (MEAN, MAX)}
            if figures[MEAN]:
                one = results.plan.rows[row]
                found = {"set": results.clip_name if name == CAPTURED else name} | _row(row, one.label, one.seeds, figures)
                rows.append(found | _paper(paper.TABLE_2.get(name, {}).get(row)))
    return rows


def table_3(results: Results) -> list[TableRow]:
    """Roughness of the controls on the clip, and the errors that the paper leaves out; empty without a clip."""
    rows = []
    for row in ("inverse", "trained", "direct", "direct_trained", "clip", "best", "holden", "optimum"):
        figures = {"roughness": results.of_inversion(row, "roughness")}
        figures |= {key: results.errors(row, CLIP, key) for key in (MEAN, MAX)}
        if figures["roughness"]:
            one = results.plan.rows[row]
            found = _row(row, LABELS_3.get(row, one.label), one.seeds, figures)
            rows.append(found | {"paper_roughness": paper.TABLE_3.get(row)})
    return rows


def orderings(results: Results) -> list[dict[str, Any]]:
    """The orderings in the paper's tables, and whether they hold here."""
    found: list[dict[str, Any]] = []
    for name in SETS[:2]:
        means = [results.mean(row, name) for row in ("inverse", "trained", "holden")]
        ours = [value for value in means if value is not None]
        if len(ours) == len(means):
            shown = f"programmatic <= trained < Holden: {' / '.join(f'{value:.3g}' for value in ours)} mm"
            label = results.clip_name if name == CAPTURED else name
            found.append({"ordering": f"{label.replace('_', ' ')}: {shown}", "holds": ours[0] <= ours[1] < ours[2]})
    for rig, (row, other) in SMOOTHER.items():
        ratio = results.smoothness_ratio(row, other)
        if ratio is not None:
            text = f"the inverse is at least 5 times smoother than direct optimisation, {rig} rig: {ratio:.3g} times"
            found.append({"ordering": text, "holds": ratio >= 5})
    error = results.rig_errors(False, MEAN)[0]
    text = f"the programmatic rig is within 0.001 mm of the true rig on average: {error:.2g} mm"
    return [*found, {"ordering": text, "holds": error <= 1e-3}]


def _row(row: str, label: str, seeds: Sequence[int], figures: dict[str, list[float]]) -> TableRow:
    """Mean, standard deviation and values over the seeds, of each figure."""
    found: TableRow = {"row": row, "label": label, "seeds": list(seeds)}
    for key, values in figures.items():
        found[key] = statistics.fmean(values) if values else None
        found[f"{key}_spread"] = statistics.stdev(values) if len(values) > 1 else None
        found[f"{key}_values"] = values
    return found


def _paper(figures: tuple[float, float] | None) -> TableRow:
    mean, greatest = figures or (None, None)
    return {f"paper_{MEAN}": mean, f"paper_{MAX}": greatest}
