"""The steps in which the judge poses: test poses, and what methods answered."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from riginv.evaluation.evaluation_sets import random_poses
from riginv.evaluation.results import BATCH_SIZE
from riginv.geometry.neighbours import evenly
from riginv.meshes.metrics import VertexError, mean_distance
from riginv.reproduce.answers import read_answers
from riginv.reproduce.cast import rig_in_space, the_true_rig, trained_rig
from riginv.reproduce.sets import CONTROLS_FILE, VERTICES_FILE, KeptPoses, Rows, the_sets
from riginv.reproduce.steps import Task, read_tensors
from riginv.reproduce.training import bundle_of
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.runs.files import atomic_write

ERRORS_FILE = "errors.safetensors"


def sample(task: Task) -> dict[str, Any]:
    """The test set of random poses, as the judge makes them; the controls are drawn as the paper draws them."""
    rig = rig_in_space(task.config["rig"]).rig
    judge = the_true_rig(task.config["judge"], rig, _workers(task))
    poses = random_poses(rig, task.config["poses"])
    with atomic_write(task.folder / VERTICES_FILE) as beside:
        shape = (len(poses), *rig.rest_vertices.shape)
        kept = np.lib.format.open_memmap(beside, mode="w+", dtype=np.float32, shape=shape)
        for start in range(0, len(poses), BATCH_SIZE):
            kept[start : start + BATCH_SIZE] = judge(poses.controls[start : start + BATCH_SIZE]).float().numpy()
        kept.flush()
        del kept
    with atomic_write(task.folder / CONTROLS_FILE) as beside, beside.open("wb") as file:
        np.save(file, poses.controls.numpy())
    return {"poses": len(poses), "judge": judge.name}


def judge(task: Task) -> dict[str, Any]:
    """What the judge makes of the controls that a method found, against the meshes that were asked for.

    Leaves the mean vertex error of each mesh that was judged, and of each vertex, mm, by set.
    """
    rig = rig_in_space(task.config["rig"]).rig
    the_rig = the_true_rig(task.config["judge"], rig, _workers(task))
    sets = the_sets(task.config["sets"], task.places, task.inputs["poses"], rig)
    figures: dict[str, Any] = {}
    kept: dict[str, Tensor] = {}
    for name, controls in read_answers(task.inputs["answer"]).items():
        rows = evenly(task.config["sets"]["meshes"], len(controls))
        found, errors, by_vertex = _compared(the_rig, Rows(sets[name], rows), controls[rows])
        figures |= {f"{name}/{key}": value for key, value in found.items()}
        kept |= {f"{name}/mesh": errors, f"{name}/vertex": by_vertex}
    with atomic_write(task.folder / ERRORS_FILE) as beside:
        save_file(kept, beside)
    return figures


def agree(task: Task) -> dict[str, Any]:
    """How far the programmatic rig, or a trained one, lies from the test poses of the judge (paper, Table 1)."""
    rig = rig_in_space(task.config["rig"])
    if "surrogate" in task.inputs:
        rig = trained_rig(str(bundle_of(task.inputs["surrogate"])), rig)
    poses = KeptPoses(task.inputs["poses"])
    return _compared(rig.rig, poses, poses.controls)[0]


def read_errors(folder: str | Path) -> dict[str, Tensor]:
    """What `judge` left: mean vertex errors, mm, by SET/mesh `(mesh,)` and SET/vertex `(vertex,)`."""
    return read_tensors(Path(folder) / ERRORS_FILE)


@torch.no_grad()
def _compared(rig: RigBackend, meshes: MeshSet, controls: Tensor) -> tuple[dict[str, float], Tensor, Tensor]:
    error, by_mesh = VertexError(), []
    total, counts = torch.zeros(2, len(rig.rest_vertices), dtype=torch.float64)
    for start, vertices in meshes.batches(BATCH_SIZE):
        found, known = rig(controls[start : start + len(vertices)]), meshes.known(start, start + len(vertices))
        error.update(found, vertices, known)
        by_mesh.append(mean_distance(found, vertices, known))
        seen = torch.ones(vertices.shape[:2], dtype=torch.bool) if known is None else known
        total += torch.where(seen, (found - vertices).norm(dim=2), 0.0).double().sum(dim=0)
        counts += seen.sum(dim=0)
    figures = {key: float(value) for key, value in error.compute().items()}
    return figures, torch.cat(by_mesh), (total / counts.clamp_min(1)).float()


def _workers(task: Task) -> int:
    """Processes for the judge, where it runs in such: this step's share of the cores."""
    return max(1, (os.cpu_count() or 1) // task.places["jobs"])
