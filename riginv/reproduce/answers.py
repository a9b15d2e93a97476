"""The step in which a method answers: meshes in, controls out, nobody judging yet."""

import time
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file
from torch import Tensor

from riginv.config.building import build, class_of
from riginv.errors import InputError
from riginv.meshes.metrics import nonzero_controls, roughness
from riginv.methods.base import Method
from riginv.methods.evaluation import Clocked
from riginv.reproduce.cast import rig_in_space, trained_rig
from riginv.reproduce.sets import CLIP, the_sets
from riginv.reproduce.steps import Task, read_tensors
from riginv.reproduce.training import bundle_of
from riginv.runs.files import atomic_write

FILE = "controls.safetensors"


def answer(task: Task) -> dict[str, Any]:
    """Let a method invert sets; its inputs may be a trained network's step, and the step of a trained rig to invert through.

    Leaves the controls `(mesh, control)` by set; the figures are how rough and how sparse these are.
    """
    programmatic = rig_in_space(task.config["rig"])
    rig = trained_rig(str(bundle_of(task.inputs["surrogate"])), programmatic) if "surrogate" in task.inputs else programmatic
    config = dict(task.config["method"])
    if "network" in task.inputs:
        config["bundle"] = str(bundle_of(task.inputs["network"]))
    if reason := class_of(config["_target_"], kind=Method).unsuited(rig.rig):
        raise InputError(f"it cannot invert rig '{rig.rig.name}', for {reason}: leave it out of budget.others")
    method: Method = build(config, programmatic if "network" in task.inputs else rig, kind=Method)
    torch.manual_seed(task.config["seed"])
    method.prepare(task.config["seed"])
    sets = the_sets(task.config["sets"], task.places, task.inputs.get("poses"), programmatic.rig)
    found: dict[str, Tensor] = {}
    figures: dict[str, Any] = {}
    for name in task.config["answers"]:
        if name not in sets:
            continue
        clocked = Clocked(sets[name])
        began = time.perf_counter()
        found[name] = method.invert(clocked).clamp(programmatic.rig.lower, programmatic.rig.upper)
        seconds = time.perf_counter() - began - clocked.seconds
        figures[f"{name}/ms_per_frame"] = 1e3 * seconds / len(clocked)
        figures[f"{name}/nonzero_controls"] = nonzero_controls(found[name], programmatic.rig)
    if CLIP in found:
        figures["roughness"] = roughness(found[CLIP], sets[CLIP].frame_numbers)
    with atomic_write(task.folder / FILE) as beside:
        save_file({name: controls.contiguous() for name, controls in found.items()}, beside)
    return figures


def read_answers(folder: str | Path) -> dict[str, Tensor]:
    """The controls `(mesh, control)` that a method found, by set."""
    return read_tensors(Path(folder) / FILE)
