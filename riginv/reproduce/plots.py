"""The steps that plot."""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from riginv.reproduce.measures import CONTROLS_FILE
from riginv.reproduce.pictures import PICTURE
from riginv.reproduce.sets import CAPTURED, CLIP, COMBINATIONS, POSES
from riginv.reproduce.steps import Figures, Task, Workspace, read_done
from riginv.reproduce.training import RUN
from riginv.reproduce.wording import MEAN
from riginv.runs.files import atomic_write

COLOURS = 10  # in the cycle of matplotlib
NAMES = {CAPTURED: "captured data", COMBINATIONS: "random combinations", POSES: "poses of the rig"}


@dataclass(frozen=True)
class Uses:
    """The inputs of a point: the controls of a method, and their evaluation."""

    controls: str
    evaluation: str


@dataclass(frozen=True)
class PlotRoughness(Task):
    """Plot error against roughness on the clip, a point for each row of the tables; lower left is better.

    Attributes:
        rows: for each seed, by label.
    """

    draws: ClassVar[bool] = True
    rows: Mapping[str, Sequence[Uses]]

    def run(self, at: Workspace) -> Figures:
        points = {}
        for label, seeds in self.rows.items():
            inverted = [_figures_of(at.inputs[uses.controls]) for uses in seeds]
            evaluated = [_figures_of(at.inputs[uses.evaluation]) for uses in seeds]
            rough = [one["roughness"] for one in inverted if "roughness" in one]
            error = [one[f"{CLIP}/{MEAN}"] for one in evaluated if f"{CLIP}/{MEAN}" in one]
            if rough and error:
                points[label] = (float(np.mean(rough)), float(np.mean(error)))
        figure, (axes,) = _figure()
        for number, (label, point) in enumerate(sorted(points.items(), key=lambda item: item[1][1])):
            axes.scatter(*point, s=50, color=f"C{number % COLOURS}", marker="o" if number < COLOURS else "s", label=label)
        figure.legend(loc="outside right center", fontsize=9, title="least error first")
        if points:
            least = min((rough for rough, _ in points.values() if rough > 0), default=1.0)
            axes.set_xscale("symlog" if any(rough <= 0 for rough, _ in points.values()) else "log")
            if axes.get_xscale() == "symlog":
                axes.set_xscale("symlog", linthresh=least)
            axes.set_yscale("log")
        axes.margins(x=0.08, y=0.08)
        axes.set_xlabel("roughness (mean squared second difference of the controls)")
        axes.set_ylabel("mean vertex error on the clip, mm")
        _save(at, figure)
        return {"points": points}


@dataclass(frozen=True)
class PlotTraining(Task):
    """Plot the validation errors of each network over its training.

    Attributes:
        columns: uses of inputs, by label.
    """

    draws: ClassVar[bool] = True
    columns: Mapping[str, str]

    def run(self, at: Workspace) -> Figures:
        curves = {label: _curves(Path(at.inputs[use]) / RUN) for label, use in self.columns.items()}
        shown = [name for name in NAMES if any(name in one for one in curves.values())]
        figure, all_axes = _figure(max(len(shown), 1))
        if not shown:
            all_axes[0].set_title("too few steps for a validation", fontsize=10)
        for name, axes in zip(shown, all_axes):
            for label, one in curves.items():
                if name in one:
                    axes.plot(*zip(*one[name]), marker=".", label=label)
            axes.set_yscale("log")
            axes.set_xlabel("training step")
            axes.set_title(NAMES[name], fontsize=10)
            axes.legend(fontsize=8)
        all_axes[0].set_ylabel("mean vertex error, mm")
        _save(at, figure)
        return {label: {name: curve[-1][1] for name, curve in one.items()} for label, one in curves.items()}


@dataclass(frozen=True)
class PlotControls(Task):
    """Plot the error of each control against its effect, a colour for each method.

    Attributes:
        columns: uses of inputs, by label.
    """

    draws: ClassVar[bool] = True
    columns: Mapping[str, str]

    def run(self, at: Workspace) -> Figures:
        figure, (axes,) = _figure()
        for label, use in self.columns.items():
            rows = json.loads((Path(at.inputs[use]) / CONTROLS_FILE).read_text(encoding="utf-8"))
            effects, errors = [row["effect_mm"] for row in rows], [100 * row["error_share"] for row in rows]
            axes.scatter(effects, errors, s=16, label=label, alpha=0.8)
        axes.set_xscale("log")
        axes.set_ylim(bottom=0)
        axes.set_xlabel("effect of a control over its range: mean over the vertices, mm")
        axes.set_ylabel("mean error of the control, % of its range")
        axes.legend(fontsize=8)
        _save(at, figure)
        return {}


def _figures_of(folder: str) -> Figures:
    done = read_done(Path(folder))
    return done["figures"] if done else {}


def _curves(run: Path) -> dict[str, list[tuple[int, float]]]:
    """Points (step, mm) by set, from the TensorBoard events of a run, across its restarts."""
    logging.getLogger("tensorboard").setLevel(logging.ERROR)  # it warns at the end of each file
    events = EventAccumulator(str(run))
    events.Reload()
    result: dict[str, list[tuple[int, float]]] = {}
    for tag in events.Tags()["scalars"]:
        kind, _, rest = tag.partition("/")
        if kind == "val" and rest.endswith(f"/{MEAN}"):
            result[rest.partition("/")[0]] = [(event.step + 1, event.value) for event in events.Scalars(tag)]
    return result


def _figure(columns: int = 1) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(8 if columns == 1 else 4.2 * columns, 5.2 if columns == 1 else 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(1, columns, number + 1) for number in range(columns)]
    for one in axes:
        one.grid(alpha=0.3)
    return figure, axes


def _save(at: Workspace, figure: Figure) -> None:
    with atomic_write(at.folder / PICTURE) as partial:
        figure.savefig(partial, format="png", dpi=110)
