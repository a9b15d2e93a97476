"""Static controls: the one value for the whole clip that costs least, by a quadratic model."""

import torch
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.geometry.neighbours import evenly
from riginv.tracking.alternation import WindowInverter
from riginv.tracking.estimators import SolverEstimator

FRAMES = 96  # sampled evenly
RIDGE = 1e-9  # relative to the curvature, for frames that do not determine a control


def spread_frames(clip: Clip, count: int = FRAMES) -> Tensor:
    """Frames `(frame, vertex, 3)` evenly spread over a clip."""
    rows = evenly(count, len(clip)).tolist()
    return torch.cat([clip.vertices(row, row + 1) for row in rows])


@torch.no_grad()
def static_values(clip: Clip, inverter: WindowInverter, estimator: SolverEstimator, static: Tensor) -> Tensor:
    """The values `(control,)` of static controls; those of other controls are arbitrary.

    Each frame contributes the Schur complement of its Gauss-Newton Hessian: the cost of a value once the other controls have
    adapted to it.

    Args:
        static: whether a control is static, `(control,)`.
    """
    found = inverter.invert(spread_frames(clip))
    controls, filled = found.controls[found.solvable], found.filled[found.solvable]
    units = estimator.units(controls)
    near = estimator.objective.linearise(units, estimator.space.encode(filled))
    chosen = static[estimator.rig.free]
    hessian = near.hessian.double()
    hessian.diagonal(dim1=1, dim2=2).add_(RIDGE * hessian.diagonal(dim1=1, dim2=2).mean(dim=1, keepdim=True) + RIDGE)
    own, both, others = hessian[:, chosen][:, :, chosen], hessian[:, chosen][:, :, ~chosen], hessian[:, ~chosen][:, :, ~chosen]
    reduced = own - both @ torch.linalg.solve(others, both.mT)
    weighted = (reduced @ units[:, chosen].double()[..., None]).sum(dim=0)
    best = torch.linalg.solve(reduced.sum(dim=0), weighted)[:, 0].clamp(0, 1)
    values = units.mean(dim=0)
    values[chosen] = best.to(units)
    return estimator.controls(values[None])[0]
