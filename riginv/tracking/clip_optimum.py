"""References for an inversion: the lowest error that the rig can reach on a few frames, and the true controls."""

from dataclasses import replace

import torch

from riginv.animation.animation import FrameErrors, SampledOptimum
from riginv.clips.clip import Clip
from riginv.evaluation.control_accuracy import control_accuracy
from riginv.evaluation.optimum import TOLERANCE
from riginv.geometry.distances import mean_distance
from riginv.geometry.kinematics import remove_motion
from riginv.geometry.neighbours import evenly
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.every_mesh import descend_mean_distance, refine_meshes, solve_meshes
from riginv.solvers.objective import Objective
from riginv.tracking.frame_evaluation import FrameEvaluator
from riginv.tracking.run import Inversion

FRAMES = 8
STARTS, STEPS, DESCENT_STEPS = 3, 60, 100


def with_accuracy(errors: FrameErrors, clip: Clip, inversion: Inversion, true_rig: RigBackend) -> FrameErrors:
    """The errors of an inversion, with the accuracy of its controls where the clip has the true ones."""
    known = ~errors.mean_mm.isnan()
    if clip.controls is None or not bool(known.any()):
        return errors
    accuracy = control_accuracy(ControlEffects.of_rig(true_rig), inversion.controls[known], clip.controls[known], is_clip=True)
    return replace(errors, controls=accuracy.as_json())


@torch.no_grad()
def with_optimum(errors: FrameErrors, clip: Clip, inversion: Inversion, evaluator: FrameEvaluator) -> FrameErrors:
    """The errors of an inversion, with the lowest that solvers reach on frames spread over the clip (`find_optima`).

    All controls are free, regardless of constraints. Unchanged for a true rig that is no differentiable `LinearRig`.
    """
    rig, known_frames = evaluator.true_rig, (~errors.mean_mm.isnan()).nonzero()[:, 0]
    if not (isinstance(rig, LinearRig) and rig.differentiable and len(known_frames)):
        return errors
    rows = known_frames[evenly(FRAMES, len(known_frames))]
    vertices = torch.cat([clip.vertices(row, row + 1) for row in rows.tolist()])
    if inversion.motion is not None:
        vertices = remove_motion(inversion.motion[rows], vertices)
    recovered = rig(inversion.controls[rows])
    known = torch.isfinite(vertices).all(dim=2)
    evaluated = known if evaluator.evaluated is None else known & evaluator.evaluated
    vertices = torch.where(evaluated[..., None], vertices, recovered)
    space = evaluator.space if rig is evaluator.rig else MeshSpace.from_rig(rig)
    objective = Objective(RigInMeshSpace(rig, space))
    coordinates = space.encode(vertices)
    squares = solve_meshes(objective, coordinates, STARTS, STEPS, TOLERANCE, DESCENT_STEPS)
    refined = refine_meshes(objective, coordinates, objective.units(inversion.controls[rows]), STEPS)
    squares.take_better(torch.arange(len(rows)), refined)
    answers = (squares.units, descend_mean_distance(objective, coordinates, squares.units))
    each = [mean_distance(rig(objective.to_controls(answer)), vertices, evaluated) for answer in answers]
    least = torch.stack([*each, errors.mean_mm[rows]]).amin(dim=0)
    return replace(errors, optimum=SampledOptimum(rows, least))
