"""Offsets of markers along the normals, estimated from a clip together with its controls and rigid motion.

Gauss-Newton on a few frames at once; the controls of each frame are eliminated from the normal equations (block arrow).
"""

import torch
from torch import Tensor

from riginv.solvers.every_mesh import refine_meshes
from riginv.tracking.markers.objective import MarkerObjective
from riginv.tracking.markers.placement import normals

FRAMES = 32  # of the clip, at most
ROUNDS = 6
STEPS = 4  # of the controls between two rounds
SPREAD_MM = 3.0  # standard deviation of the offsets about their common value
MOST_MM = 60.0
CONVERGED_MM = 0.02


def calibrate(objective: MarkerObjective, packed: Tensor, units: Tensor, noise_mm: float) -> Tensor:
    """The offsets `(marker,)` that fit a clip best; those of markers that are not to be calibrated stay.

    Args:
        packed: the clip.
        units: approximate controls `(frame, control)`; they are not changed.
        noise_mm: standard deviation of a marker's error.
    """
    placement = objective.placement
    offsets, free = placement.offset_mm.double().clone(), placement.calibrated
    known = torch.isfinite(packed).all(dim=1).nonzero()[:, 0]
    rows = known[torch.linspace(0, len(known) - 1, min(FRAMES, len(known))).round().long()] if len(known) else known
    if not bool(free.any()) or not len(rows):
        return placement.offset_mm
    some, target = units[rows], packed[rows]
    ridge = (noise_mm / SPREAD_MM) ** 2
    for _ in range(ROUNDS):
        change = _step(objective.at_offsets(offsets.float()), some, target, offsets, free, ridge)
        offsets = torch.where(free, (offsets + change).clamp(-MOST_MM, MOST_MM), offsets)
        if float(change[free].abs().max()) < CONVERGED_MM:
            break
        some = refine_meshes(objective.at_offsets(offsets.float()), target, some, STEPS).units
    return offsets.to(placement.offset_mm)


@torch.no_grad()
def _step(objective: MarkerObjective, units: Tensor, packed: Tensor, offsets: Tensor, free: Tensor, ridge: float) -> Tensor:
    """The change `(marker,)` of the offsets; 0 for those that are not free."""
    near, priors = objective.derivatives(units, packed), objective.linearise(units, packed)
    count = len(free)
    weighted = near.residuals.weights.sqrt()[..., None] * normals(near.residuals.corners)[0]
    by_offset = torch.zeros(len(units), count, 3, count).to(weighted)
    by_offset[:, torch.arange(count), :, torch.arange(count)] = weighted.transpose(0, 1)
    by_offset = by_offset.flatten(1, 2)
    by_offset = (by_offset - near.rigid @ (near.rigid.mT @ by_offset)).double()
    hessian = priors.hessian.double()
    hessian.diagonal(dim1=1, dim2=2).add_(1e-6 * hessian.diagonal(dim1=1, dim2=2).mean(dim=1, keepdim=True))
    across = near.columns.double().mT @ by_offset
    solved = torch.linalg.solve(hessian, torch.cat([across, priors.gradient.double()[..., None]], dim=2))
    pull = (by_offset.mT @ near.residual.double()[..., None])[..., 0] - (across.mT @ solved[..., -1:])[..., 0]
    matrix = (by_offset.mT @ by_offset - across.mT @ solved[..., :-1]).sum(dim=0)
    common = offsets[free].mean()
    # the ridge acts on differences from the common offset, which stays free
    centre = torch.eye(count, dtype=torch.float64) - 1 / max(int(free.sum()), 1)
    matrix, force = matrix + ridge * len(units) * centre, pull.sum(dim=0) + ridge * len(units) * (offsets - common)
    some = free.nonzero()[:, 0]
    inner = matrix[some][:, some] + 1e-9 * torch.eye(len(some), dtype=torch.float64)
    change = torch.zeros_like(offsets)
    change[some] = -torch.linalg.solve(inner, force[some])
    return change
