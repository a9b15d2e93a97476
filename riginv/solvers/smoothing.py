"""Curves made smooth without looking at any mesh: a start for the solver of clips."""

import torch
from torch import Tensor

from riginv.solvers.levenberg_marquardt import Solution


def smoothed(solution: Solution, blur: float) -> Tensor:
    """The controls `(frame, control)` of a clip's frames, blurred over time; frames that were skipped do not count.

    Args:
        blur: standard deviation of the Gaussian, frames; 0: none.
    """
    if not len(solution.units):
        return solution.units
    reach = max(1, round(3 * blur))
    place = torch.arange(-reach, reach + 1, dtype=solution.units.dtype)
    kernel = torch.exp(-0.5 * (place / max(blur, 1e-3)) ** 2)
    known = (~solution.skipped).to(kernel)[:, None]
    values = torch.cat([solution.units * known, known], dim=1).T[:, None]
    total = torch.nn.functional.conv1d(values, kernel[None, None], padding=reach)[:, 0].T
    near = total[:, :-1] / total[:, -1:].clamp_min(1e-12)
    return torch.where(total[:, -1:] > 1e-12, near, solution.units)
