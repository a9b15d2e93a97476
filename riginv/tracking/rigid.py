"""Robust rigid motion between two meshes: vertices that deform count little.

No skin moves exactly with the skull, so that plain least squares would follow the jaw and the brows. Each vertex is weighted by
its stability and by its residual: iteratively reweighted least squares with the weights of Geman and McClure (1987).
Refitting to the mesh at the estimated controls removes the remaining bias.
"""

import roma
import torch
from torch import Tensor

from riginv.geometry.kernels.library import Kernels, kernels_for
from riginv.geometry.kinematics import apply_motion

ITERATIONS = 8  # of reweighting, without a start
ITERATIONS_FROM_START = 3
SCALE = 3.0  # scale of the weights, in median distances
MIN_SCALE_MM = 0.05
CONVERGED_MM = 1e-3  # mean vertex displacement by an iteration


def fit_rigid(source: Tensor, target: Tensor, weights: Tensor, start: Tensor | None = None) -> Tensor:
    """The rigid motions `(frame, 4, 4)`, mm, from source to target meshes.

    Args:
        source: `(frame, vertex, 3)`, or one mesh for all `(1, vertex, 3)`.
        target: `(frame, vertex, 3)`; vertices with NaN are ignored.
        weights: of the vertices, `(vertex,)`.
        start: approximate motions, `(frame, 4, 4)`.

    Returns:
        motions; the identity where fewer than three vertices are known.
    """
    if (compiled := kernels_for(source, target, weights, *([] if start is None else [start]))) is not None:
        return _compiled(compiled, source, target, weights, start)
    known = torch.isfinite(target).all(dim=2)
    base = weights * known
    enough = (base > 0).sum(dim=1) >= 3
    base = torch.where(enough[:, None], base, 1.0)  # weights of 0 have no centre
    target = torch.where(known[..., None], target, 0.0)
    source = source.expand_as(target)
    if start is None:
        rotation, translation = roma.rigid_points_registration(source, target, base)
    else:
        rotation, translation = start[:, :3, :3], start[:, :3, 3]
    moved = source @ rotation.mT + translation[:, None]
    for _ in range(ITERATIONS if start is None else ITERATIONS_FROM_START):
        distance = (moved - target).norm(dim=2)
        typical = torch.where(known, distance, torch.nan).nanmedian(dim=1).values
        scale = (SCALE * typical.nan_to_num(0.0)).clamp_min(MIN_SCALE_MM)[:, None]
        rotation, translation = roma.rigid_points_registration(source, target, base / (1 + (distance / scale) ** 2) ** 2)
        before, moved = moved, source @ rotation.mT + translation[:, None]
        if float((moved - before).norm(dim=2).mean(dim=1).max()) < CONVERGED_MM:
            break
    motion = torch.eye(4).to(rotation).expand(len(rotation), -1, -1).clone()
    motion[enough, :3, :3], motion[enough, :3, 3] = rotation[enough], translation[enough]
    return motion


def rigid_change(before: Tensor, points_before: Tensor, after: Tensor, points_after: Tensor) -> Tensor:
    """The mean distance `(frame,)`, mm, between points `(frame, point, 3)` moved by `before` and others moved by `after`.

    Args:
        before, after: motions, `(frame, 4, 4)`.
    """
    given = before, points_before, after, points_after
    if (compiled := kernels_for(*given)) is None:
        return (apply_motion(after, points_after) - apply_motion(before, points_before)).norm(dim=2).mean(dim=1)
    result = before.new_empty(len(before))
    contiguous = [values.contiguous() for values in given]
    compiled.call("rigid_change", before.dtype, *contiguous, points_after.shape[1], result, len(before))
    return result


def _compiled(compiled: Kernels, source: Tensor, target: Tensor, weights: Tensor, start: Tensor | None) -> Tensor:
    """`fit_rigid` by a kernel, which ends the iterations of each frame on its own."""
    frames, points = target.shape[:2]
    motion = target.new_empty(frames, 4, 4) if start is None else start.clone(memory_format=torch.contiguous_format)
    numbers = target.new_tensor([SCALE, MIN_SCALE_MM, CONVERGED_MM])
    given = (
        source.contiguous(),
        int(len(source) == 1),
        target.contiguous(),
        weights.contiguous(),
        numbers,
        int(start is not None),
    )
    iterations = ITERATIONS if start is None else ITERATIONS_FROM_START
    compiled.call("fit_rigid", target.dtype, *given, iterations, points, motion, frames)
    return motion
