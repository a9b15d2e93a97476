"""The step in which a method inverts mesh sets."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor

from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.meshes.metrics import nonzero_controls, roughness
from riginv.methods.base import Method
from riginv.methods.evaluation import Clocked
from riginv.reproduce.rigs import rig_in_space, trained_rig
from riginv.reproduce.sets import CLIP, mesh_sets
from riginv.reproduce.steps import Figures, Task, Workspace, read_tensors
from riginv.reproduce.training import bundle_of
from riginv.runs.files import atomic_write

FILE = "controls.safetensors"


@dataclass(frozen=True)
class InvertSets(Task):
    """Invert sets; write the controls `(mesh, control)` by set. Figures are the time, the roughness and the sparsity.

    Inputs may be `network`, a trained network, and `surrogate`, a trained rig to invert through.

    Attributes:
        names: of the sets.
    """

    method: ClassSpec[Method]
    names: tuple[str, ...]
    seed: int

    def run(self, at: Workspace) -> Figures:
        """Invert the sets.

        Raises:
            InputError: the method cannot invert the rig.
        """
        programmatic = rig = rig_in_space(self.rig)
        if "surrogate" in at.inputs:
            rig = trained_rig(str(bundle_of(at.inputs["surrogate"])), programmatic)
        if reason := self.method.target_class.unsuited(rig.source):
            raise InputError(f"it cannot invert rig '{rig.source.name}', for {reason}: leave it out of budget.others")
        if "network" in at.inputs:
            bundle = str(bundle_of(at.inputs["network"]))
            method = replace(self.method, config={**self.method.config, "bundle": bundle}).build(programmatic)
        else:
            method = self.method.build(rig)
        torch.manual_seed(self.seed)
        method.prepare(self.seed)
        sets = mesh_sets(self.sets, at.context.capture, programmatic.source, at.inputs.get("poses"))
        found: dict[str, Tensor] = {}
        figures: Figures = {}
        for name in self.names:
            if name not in sets:
                continue
            clocked = Clocked(sets[name])
            began = time.perf_counter()
            found[name] = method.invert(clocked).clamp(programmatic.source.lower, programmatic.source.upper)
            seconds = time.perf_counter() - began - clocked.seconds
            figures[f"{name}/ms_per_frame"] = 1e3 * seconds / len(clocked)
            figures[f"{name}/nonzero_controls"] = nonzero_controls(found[name], programmatic.source)
        if CLIP in found:
            figures["roughness"] = roughness(found[CLIP], sets[CLIP].frame_numbers)
        with atomic_write(at.folder / FILE) as partial:
            save_file({name: controls.contiguous() for name, controls in found.items()}, partial)
        return figures


def read_controls(folder: str | Path) -> dict[str, Tensor]:
    """The controls `(mesh, control)` that a method found, by set."""
    return read_tensors(Path(folder) / FILE)
