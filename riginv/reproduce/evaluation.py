"""The steps that pose the true rig: test poses, and the evaluation of controls that methods found."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from riginv.config.building import ClassSpec
from riginv.evaluation.evaluation_sets import random_poses
from riginv.evaluation.results import BATCH_SIZE
from riginv.geometry.distances import mean_distance
from riginv.geometry.neighbours import evenly
from riginv.meshes.vertex_error import VertexError
from riginv.reproduce.inversion import read_controls
from riginv.reproduce.rigs import rig_in_space, trained_rig, true_rig
from riginv.reproduce.sets import CONTROLS_FILE, VERTICES_FILE, SampledPoses, Subset, mesh_sets
from riginv.reproduce.steps import Context, Figures, Task, Workspace, read_tensors
from riginv.reproduce.training import bundle_of
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.runs.files import atomic_write

ERRORS_FILE = "errors.safetensors"


@dataclass(frozen=True)
class SamplePoses(Task):
    """Write the test set of random poses of the true rig; controls are sampled as in the paper.

    Attributes:
        true_rig: None: the programmatic rig.
        count: number of poses.
    """

    true_rig: ClassSpec[RigBackend] | None
    count: int

    def run(self, at: Workspace) -> Figures:
        rig = rig_in_space(self.rig).source
        reference = true_rig(self.true_rig, rig, _workers(at.context))
        poses = random_poses(rig, self.count)
        with atomic_write(at.folder / VERTICES_FILE) as partial:
            shape = (len(poses), *rig.rest_vertices.shape)
            written = np.lib.format.open_memmap(partial, mode="w+", dtype=np.float32, shape=shape)
            for start in range(0, len(poses), BATCH_SIZE):
                rows = slice(start, start + BATCH_SIZE)
                written[rows] = reference(poses.controls[rows]).float().numpy()
            written.flush()
            del written
        with atomic_write(at.folder / CONTROLS_FILE) as partial, partial.open("wb") as file:
            np.save(file, poses.controls.numpy())
        return {"poses": len(poses), "true_rig": reference.name}


@dataclass(frozen=True)
class EvaluateControls(Task):
    """Compare the true rig, posed with the controls that a method found, with the meshes that were inverted.

    Writes the mean vertex error of each evaluated mesh and of each vertex, mm, by set.

    Attributes:
        true_rig: None: the programmatic rig.
    """

    true_rig: ClassSpec[RigBackend] | None

    def run(self, at: Workspace) -> Figures:
        rig = rig_in_space(self.rig).source
        reference = true_rig(self.true_rig, rig, _workers(at.context))
        sets = mesh_sets(self.sets, at.context.capture, rig, at.inputs["poses"])
        figures: Figures = {}
        errors: dict[str, Tensor] = {}
        for name, controls in read_controls(at.inputs["controls"]).items():
            rows = evenly(self.sets.meshes, len(controls))
            found, by_mesh, by_vertex = _compared(reference, Subset(sets[name], rows), controls[rows])
            figures |= {f"{name}/{key}": value for key, value in found.items()}
            errors |= {f"{name}/mesh": by_mesh, f"{name}/vertex": by_vertex}
        with atomic_write(at.folder / ERRORS_FILE) as partial:
            save_file(errors, partial)
        return figures


@dataclass(frozen=True)
class EvaluateRig(Task):
    """Compare the programmatic rig, or a trained one (`surrogate`), with the test poses (paper, Table 1)."""

    def run(self, at: Workspace) -> Figures:
        rig = rig_in_space(self.rig)
        if "surrogate" in at.inputs:
            rig = trained_rig(str(bundle_of(at.inputs["surrogate"])), rig)
        poses = SampledPoses(at.inputs["poses"])
        return dict(_compared(rig.source, poses, poses.controls)[0])


def read_errors(folder: str | Path) -> dict[str, Tensor]:
    """The results of `EvaluateControls`: mean vertex errors, mm, by SET/mesh `(mesh,)` and SET/vertex `(vertex,)`."""
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


def _workers(context: Context) -> int:
    """A step's share of the cores, for true rigs with worker processes."""
    return max(1, (os.cpu_count() or 1) // context.jobs)
