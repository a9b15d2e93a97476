"""What steps do, by name, and how one is run: whole, or to be gone on with."""

import contextlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from riginv.reproduce import answers, judging, measures, pictures, plots, training
from riginv.reproduce.steps import LOG, Task, write_done

WORKS: dict[str, Callable[[Task], dict[str, Any]]] = {
    "sample": judging.sample,
    "train": training.train,
    "answer": answers.answer,
    "judge": judging.judge,
    "agree": judging.agree,
    "lipschitz": measures.lipschitz,
    "controls": measures.controls_that_matter,
    "draw_denoising": pictures.denoising,
    "draw_body": pictures.body,
    "draw_maps": pictures.error_maps,
    "plot_roughness": plots.error_and_roughness,
    "plot_curves": plots.training_curves,
    "plot_controls": plots.controls_that_matter,
}


def run_step(work: str, config: Mapping[str, Any], places: Mapping[str, Any], inputs: Mapping[str, str], folder: str) -> None:
    """Run a step in its folder, and mark it as finished.

    What it would print goes into the folder's log.txt.
    """
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    with (path / LOG).open("a", encoding="utf-8") as log:
        with contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
            figures = WORKS[work](Task(config, places, inputs, path))
    write_done(path, time.monotonic() - began, figures)
