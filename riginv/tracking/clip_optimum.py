"""References for an inversion: the lowest error that the rig can reach on a few frames, and the true controls."""

from dataclasses import replace

import torch

from riginv.animation.animation import FrameErrors, SampledOptimum
from riginv.clips.clip import Clip
from riginv.evaluation.control_accuracy import control_accuracy
from riginv.evaluation.optimum import BOUND, Budget, basis_for, least_errors
from riginv.geometry.kinematics import remove_motion
from riginv.geometry.neighbours import evenly
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.objective import Objective
from riginv.tracking.frame_evaluation import FrameEvaluator
from riginv.tracking.run import Inversion

FRAMES = 8
BUDGET = Budget(3, 60, descent_steps=100)


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

    All controls are free, regardless of constraints. An upper bound where a basis was fitted to the true rig; unchanged where
    no gradient passes.
    """
    true_rig, known_frames = evaluator.true_rig, (~errors.mean_mm.isnan()).nonzero()[:, 0]
    rig = basis_for(true_rig, evaluator.rig if isinstance(evaluator.rig, LinearRig) else None)
    if rig is None or not len(known_frames):
        return errors
    rows = known_frames[evenly(FRAMES, len(known_frames))]
    vertices = torch.cat([clip.vertices(row, row + 1) for row in rows.tolist()])
    if inversion.motion is not None:
        vertices = remove_motion(inversion.motion[rows], vertices)
    start = inversion.controls[rows]
    known = torch.isfinite(vertices).all(dim=2)
    evaluated = known if evaluator.evaluated is None else known & evaluator.evaluated
    vertices = torch.where(evaluated[..., None], vertices, true_rig(start))
    space = evaluator.space if rig is evaluator.rig else MeshSpace.from_rig(rig)
    is_bound = rig is not true_rig
    found = least_errors(
        Objective(RigInMeshSpace(rig, space)), true_rig, vertices, evaluated, BOUND if is_bound else BUDGET, start
    )
    return replace(errors, optimum=SampledOptimum(rows, torch.minimum(found, errors.mean_mm[rows]), is_bound))
