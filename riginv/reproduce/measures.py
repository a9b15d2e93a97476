"""Measures of an inverse other than errors: its local Lipschitz constant, and its error in each control."""

from dataclasses import dataclass

import torch

from riginv.geometry.neighbours import evenly
from riginv.inference.inverse import load_inverse
from riginv.reproduce.inversion import read_controls
from riginv.reproduce.rigs import rig_in_space
from riginv.reproduce.sets import CAPTURED, COMBINATIONS, POSES, SampledPoses, mesh_sets
from riginv.reproduce.steps import Figures, Task, Workspace
from riginv.reproduce.training import bundle_of
from riginv.rig.batches import generator_at
from riginv.runs.files import write_json

TITLE = "Rig Inversion by Training a Differentiable Rig Function"
RIG = "its face: 137 controls, 628 weights, 8,447 vertices, evaluated in Maya; its own capture data"

# Mean and maximum vertex error, mm.
TABLE_1 = {"programmatic": (0.22, 1.4), "trained": (0.78, 5.9)}
TABLE_2 = {
    COMBINATIONS: {"inverse": (2.5, 15.0), "trained": (3.0, 17.2), "holden": (9.2, 100.0)},
    CAPTURED: {"inverse": (4.8, 49.0), "trained": (4.9, 49.1), "holden": (10.0, 99.0)},
}
# Roughness: mean squared second difference of the controls.
TABLE_3 = {"inverse": 3.8e-3, "trained": 3.4e-3, "direct": 2.3e-2, "direct_trained": 2.7e-2}


DISTURBANCE_MM = 0.1  # of each vertex, root mean square
DISTURBANCES, MESHES = 16, 64
CONTROLS_FILE = "controls.json"


@dataclass(frozen=True)
class MeasureLipschitz(Task):
    """The local Lipschitz constant of an inverse, in ranges of the controls per mm.

    It is the greatest norm of the change of the controls over the root mean square of the disturbance over the vertices, for
    disturbances of 0.1 mm within the span of the blendshapes; the mean over meshes of the captured data.
    """

    seed: int

    @torch.no_grad()
    def run(self, at: Workspace) -> Figures:
        rig = rig_in_space(self.rig)
        sets = mesh_sets(self.sets, at.context.capture, rig.source)
        meshes = sets.get(CAPTURED) or sets[COMBINATIONS]
        network = load_inverse(bundle_of(at.inputs["network"]), rig.source).network
        span = rig.source.upper - rig.source.lower
        generator = generator_at(self.seed, "disturbances")
        constants = []
        for row in evenly(MESHES, len(meshes)).tolist():
            coordinates = network.rig.space.encode(meshes.vertices(row, row + 1))
            change = torch.randn(DISTURBANCES, coordinates.shape[1], generator=generator)
            change = change / change.norm(dim=1, keepdim=True) * DISTURBANCE_MM * rig.space.vertex_count**0.5
            moved = ((network(coordinates + change) - network(coordinates)) / span).norm(dim=1)
            constants.append(moved.max() / DISTURBANCE_MM)
        return {"ranges_per_mm": float(torch.stack(constants).mean())}


@dataclass(frozen=True)
class MeasureControls(Task):
    """The effect of each control, and its error in an inverse on poses of the rig (paper, Sec. 3.1.3).

    Writes `controls.json`: name, mean effect on the vertices over its range, mm, and mean error as a fraction of its range.
    """

    @torch.no_grad()
    def run(self, at: Workspace) -> Figures:
        rig = rig_in_space(self.rig).source
        neutral, span = rig.neutral_controls, rig.upper - rig.lower
        far = torch.where(rig.upper - neutral >= neutral - rig.lower, rig.upper, rig.lower)
        effects = []
        for number in range(len(far)):
            posed = rig(torch.where(torch.arange(len(far)) == number, far, neutral)[None])[0]
            effects.append(float((posed - rig.rest_vertices).norm(dim=1).mean()))
        found = read_controls(at.inputs["controls"])[POSES]
        errors = ((found - SampledPoses(at.inputs["poses"]).controls[: len(found)]).abs() / span).mean(dim=0).tolist()
        rows = [
            {"control": name, "effect_mm": effect, "error_share": error}
            for name, effect, error in zip(rig.control_names, effects, errors)
        ]
        write_json(at.folder / CONTROLS_FILE, rows)
        ranks = torch.tensor([effects, errors]).argsort(dim=1).argsort(dim=1).double()
        return {"rank_correlation": float(torch.corrcoef(ranks)[0, 1])}
