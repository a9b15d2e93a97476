"""How a rig's controls change from frame to frame: the covariance of their second differences over the takes of a prior."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from riginv.rig.interface import RigBackend
from riginv.solvers.band import second_differences, usual_steps
from riginv.tracking.priors.prior import ControlPrior
from riginv.tracking.priors.takes import Take

LEAST = 0.01  # of its range: standard deviation of a second difference at `LEAST_FPS` that every control has at least
LEAST_FPS = 30.0


def with_changes(prior: ControlPrior, rig: RigBackend, takes: Sequence[Take]) -> ControlPrior:
    """The prior with the changes of takes; as it is where no take has three frames in a row."""
    lower, span = rig.lower.double().cpu(), (rig.upper - rig.lower).double().cpu()
    total, count = torch.zeros_like(prior.covariance), 0
    for take in (take for take in takes if len(take.numbers) > 2):
        weights = second_differences(usual_steps(take.numbers))
        units = ((take.controls.double().cpu() - lower) / span).clamp(0, 1)
        second = weights[:, :1] * units[:-2] + weights[:, 1:2] * units[1:-1] + weights[:, 2:] * units[2:]
        second = second[weights.any(dim=1)]  # not across long gaps
        total, count = total + take.rate**3 * (second.T @ second), count + len(second)
    if not count:
        return prior
    least = LEAST**2 * LEAST_FPS**3 * torch.eye(len(total), dtype=torch.float64)
    return replace(prior, changes=total / count + least)
