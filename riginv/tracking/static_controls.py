"""Controls with one value for the whole clip: the value that costs the clip least, as far as a quadratic model tells."""

import torch
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.geometry.neighbours import evenly
from riginv.tracking.alternation import WindowInverter
from riginv.tracking.estimators import SolverEstimator

FRAMES = 96  # of the clip that decide, spread evenly
FAINT = 1e-9  # of the curvature, added so that a frame that says nothing of a control does not matter


def spread_frames(clip: Clip, count: int = FRAMES) -> Tensor:
    """Frames `(frame, vertex, 3)` spread evenly over a clip, in their order."""
    rows = evenly(count, len(clip)).tolist()
    return torch.cat([clip.vertices(row, row + 1) for row in rows])


@torch.no_grad()
def static_values(clip: Clip, inverter: WindowInverter, solving: SolverEstimator, static: Tensor) -> Tensor:
    """The values `(control,)` of static controls; those of others mean nothing.

    Each frame says what it would like, and how much it minds another value, once its other controls have made up for it: the
    Schur complement of the Gauss-Newton Hessian.

    Args:
        static: `(control,)`, whether a control is.
    """
    found = inverter.invert(spread_frames(clip))
    controls, complete = found.controls[found.present], found.complete[found.present]
    units = solving.units(controls)
    near = solving.objective.linearise(units, solving.space.encode(complete))
    chosen = static[solving.held.free]
    hessian = near.hessian.double()
    hessian.diagonal(dim1=1, dim2=2).add_(FAINT * hessian.diagonal(dim1=1, dim2=2).mean(dim=1, keepdim=True) + FAINT)
    own, both, others = hessian[:, chosen][:, :, chosen], hessian[:, chosen][:, :, ~chosen], hessian[:, ~chosen][:, :, ~chosen]
    minded = own - both @ torch.linalg.solve(others, both.mT)
    wanted = (minded @ units[:, chosen].double()[..., None]).sum(dim=0)
    best = torch.linalg.solve(minded.sum(dim=0), wanted)[:, 0].clamp(0, 1)
    together = units.mean(dim=0)
    together[chosen] = best.to(units)
    return solving.controls(together[None])[0]
