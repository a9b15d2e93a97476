"""Gradient descent through a rig: slow, but out of reach of a rig's saturations it finds better places than Newton's steps."""

import torch
from torch import Tensor

from riginv.rig.mesh_space import RigInMeshSpace


def descend(rig: RigInMeshSpace, start: Tensor, coordinates: Tensor, steps: int, lr: float) -> Tensor:
    """Adam on the squared distance to meshes, each within the limits.

    Args:
        start: controls `(mesh, control)`.
        coordinates: `(mesh, coordinate)`.
        lr: step size, of a control's range.

    Returns:
        The best controls `(mesh, control)` met on the way; the start for meshes that hold NaN.
    """
    backend = rig.rig
    span = backend.upper - backend.lower
    unit = ((start - backend.lower) / span).detach().clone().requires_grad_()  # every control runs from 0 to 1: one rate fits
    optimizer = torch.optim.Adam([unit], lr=lr)
    best, least = start.clone(), torch.full_like(start[:, 0], torch.inf)
    with torch.no_grad():
        for step in range(steps + 1):
            controls = backend.lower + span * unit
            found, pull = rig.coordinates_and_pull(controls)
            residual = found - coordinates
            errors = residual.square().sum(dim=1)
            better = errors < least
            best = torch.where(better[:, None], controls, best)
            least = torch.where(better, errors, least)
            if step == steps:
                break
            unit.grad = (2 / rig.space.vertex_count * span * pull(residual)).nan_to_num_()
            optimizer.step()
            unit.clamp_(0, 1)
    return best.clamp(backend.lower, backend.upper)
