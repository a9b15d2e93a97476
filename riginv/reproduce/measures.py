"""What is measured of an inverse beside its errors: how it magnifies small disturbances, and which controls it gets right."""

from typing import Any

import torch

from riginv.geometry.neighbours import evenly
from riginv.inference.inverse import load_inverse
from riginv.reproduce.answers import read_answers
from riginv.reproduce.cast import rig_in_space
from riginv.reproduce.sets import CAPTURED, COMBINATIONS, POSES, KeptPoses, the_sets
from riginv.reproduce.steps import Task
from riginv.reproduce.training import bundle_of
from riginv.rig.batches import generator_at
from riginv.runs.files import write_json

TITLE = "Rig Inversion by Training a Differentiable Rig Function"
RIG = "its face: 137 controls, 628 weights, 8,447 vertices, judged by Maya; its own capture data"

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


@torch.no_grad()
def lipschitz(task: Task) -> dict[str, Any]:
    """The local Lipschitz constant of an inverse, controls' ranges per mm: the greatest change of its controls against that of
    the mesh, over disturbances of 0.1 mm that the rig's space can see; the mean over meshes of the captured data.

    A change of the mesh is the root mean square over its vertices, one of the controls the root of their squares' sum.
    """
    rig = rig_in_space(task.config["rig"])
    sets = the_sets(task.config["sets"], task.places, None, rig.rig)
    meshes = sets.get(CAPTURED) or sets[COMBINATIONS]
    network = load_inverse(bundle_of(task.inputs["network"]), rig.rig).network
    span = rig.rig.upper - rig.rig.lower
    generator = generator_at(task.config["seed"], "disturbances")
    constants = []
    for row in evenly(MESHES, len(meshes)).tolist():
        coordinates = network.rig.space.encode(meshes.vertices(row, row + 1))
        change = torch.randn(DISTURBANCES, coordinates.shape[1], generator=generator)
        change = change / change.norm(dim=1, keepdim=True) * DISTURBANCE_MM * rig.space.vertex_count**0.5
        moved = ((network(coordinates + change) - network(coordinates)) / span).norm(dim=1)
        constants.append(moved.max() / DISTURBANCE_MM)
    return {"ranges_per_mm": float(torch.stack(constants).mean())}


@torch.no_grad()
def controls_that_matter(task: Task) -> dict[str, Any]:
    """For each control, what it moves, and how far off an inverse gets it on poses of the rig (paper, Sec. 3.1.3).

    Leaves `controls.json`: name, mean effect on the vertices over its whole range, mm, and mean error, shares of its range.
    """
    rig = rig_in_space(task.config["rig"]).rig
    neutral, span = rig.neutral_controls, rig.upper - rig.lower
    far = torch.where(rig.upper - neutral >= neutral - rig.lower, rig.upper, rig.lower)
    effects = [
        float(
            (rig(torch.where(torch.arange(len(far)) == number, far, neutral)[None])[0] - rig.rest_vertices).norm(dim=1).mean()
        )
        for number in range(len(far))
    ]
    found = read_answers(task.inputs["answer"])[POSES]
    errors = ((found - KeptPoses(task.inputs["poses"]).controls[: len(found)]).abs() / span).mean(dim=0).tolist()
    rows = [
        {"control": name, "effect_mm": effect, "error_share": error}
        for name, effect, error in zip(rig.control_names, effects, errors)
    ]
    write_json(task.folder / CONTROLS_FILE, rows)
    ranks = torch.tensor([effects, errors]).argsort(dim=1).argsort(dim=1).double()
    return {"rank_correlation": float(torch.corrcoef(ranks)[0, 1])}
