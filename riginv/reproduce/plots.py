"""The steps that plot."""

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from riginv.reproduce.measures import CONTROLS_FILE
from riginv.reproduce.pictures import PICTURE
from riginv.reproduce.sets import CAPTURED, CLIP, COMBINATIONS, POSES
from riginv.reproduce.steps import Task, read_done
from riginv.reproduce.training import RUN
from riginv.reproduce.wording import MEAN
from riginv.runs.files import atomic_write

COLOURS = 10  # that matplotlib goes round
NAMES = {CAPTURED: "captured data", COMBINATIONS: "random combinations", POSES: "poses of the rig"}


def error_and_roughness(task: Task) -> dict[str, Any]:
    """Error against roughness on the clip, a point for each row of the tables; lower left is better."""
    points = {}
    for label, uses in task.config["rows"].items():
        done = [[read_done(Path(task.inputs[use]))["figures"] for use in pair] for pair in uses]
        rough = [answered["roughness"] for answered, _ in done if "roughness" in answered]
        error = [judged[f"{CLIP}/{MEAN}"] for _, judged in done if f"{CLIP}/{MEAN}" in judged]
        if rough and error:
            points[label] = (float(np.mean(rough)), float(np.mean(error)))
    figure, axes = _figure()
    for number, (label, place) in enumerate(sorted(points.items(), key=lambda item: item[1][1])):
        axes.scatter(*place, s=50, color=f"C{number % COLOURS}", marker="o" if number < COLOURS else "s", label=label)
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
    _save(task, figure)
    return {"points": points}


def training_curves(task: Task) -> dict[str, Any]:
    """The errors of each network while it learned, as validation saw them."""
    curves = {label: _curves(Path(task.inputs[use]) / RUN) for label, use in task.config["columns"].items()}
    shown = [name for name in NAMES if any(name in one for one in curves.values())]
    figure, *all_axes = _figure(max(len(shown), 1))
    if not shown:
        all_axes[0].set_title("too few steps: validation never looked", fontsize=10)
    for name, axes in zip(shown, all_axes):
        for label, one in curves.items():
            if name in one:
                axes.plot(*zip(*one[name]), marker=".", label=label)
        axes.set_yscale("log")
        axes.set_xlabel("training step")
        axes.set_title(NAMES[name], fontsize=10)
        axes.legend(fontsize=8)
    all_axes[0].set_ylabel("mean vertex error, mm")
    _save(task, figure)
    return {label: {name: curve[-1][1] for name, curve in one.items()} for label, one in curves.items()}


def controls_that_matter(task: Task) -> dict[str, Any]:
    """How far off each control comes out against what it moves, a colour for each method."""
    figure, axes = _figure()
    for label, use in task.config["columns"].items():
        rows = json.loads((Path(task.inputs[use]) / CONTROLS_FILE).read_text(encoding="utf-8"))
        axes.scatter(
            [row["effect_mm"] for row in rows], [100 * row["error_share"] for row in rows], s=16, label=label, alpha=0.8
        )
    axes.set_xscale("log")
    axes.set_ylim(bottom=0)
    axes.set_xlabel("what a control moves over its range: mean over the vertices, mm")
    axes.set_ylabel("mean error of the control, % of its range")
    axes.legend(fontsize=8)
    _save(task, figure)
    return {}


def _curves(run: Path) -> dict[str, list[tuple[int, float]]]:
    """Points (step, mm) by set, from TensorBoard's events of a run, across its restarts."""
    logging.getLogger("tensorboard").setLevel(logging.ERROR)  # it complains of the end of each file
    events = EventAccumulator(str(run))
    events.Reload()
    result = {}
    for tag in events.Tags()["scalars"]:
        kind, _, rest = tag.partition("/")
        if kind == "val" and rest.endswith(f"/{MEAN}"):
            result[rest.partition("/")[0]] = [(event.step + 1, event.value) for event in events.Scalars(tag)]
    return result


def _figure(columns: int = 1) -> tuple[Figure | Axes, ...]:
    figure = Figure(figsize=(8 if columns == 1 else 4.2 * columns, 5.2 if columns == 1 else 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = [figure.add_subplot(1, columns, number + 1) for number in range(columns)]
    for one in axes:
        one.grid(alpha=0.3)
    return figure, *axes


def _save(task: Task, figure: Figure) -> None:
    with atomic_write(task.folder / PICTURE) as beside:
        figure.savefig(beside, format="png", dpi=110)
