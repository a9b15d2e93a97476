"""Curves made smooth without looking at any mesh: a start for the solver of clips."""

import torch
from torch import Tensor

from riginv.solvers.band import spans
from riginv.solvers.levenberg_marquardt import Solution


def smoothed(solution: Solution, blur: float, numbers: Tensor | None = None) -> Tensor:
    """The controls `(frame, control)` of a clip's frames, blurred over time; frames that were skipped do not count.

    Args:
        blur: standard deviation of the Gaussian, frames; 0: none.
        numbers: of the frames, `(frame,)`: nothing is blurred across long gaps; None: no frame is missing.
    """
    if not len(solution.units):
        return solution.units
    reach = max(1, round(3 * blur))
    place = torch.arange(-reach, reach + 1, dtype=solution.units.dtype)
    kernel = torch.exp(-0.5 * (place / max(blur, 1e-3)) ** 2)
    known = (~solution.skipped).to(kernel)[:, None]
    values = torch.cat([solution.units * known, known], dim=1)
    parts = spans(torch.arange(len(values)) if numbers is None else numbers)
    total = torch.cat([_blurred(values[rows], kernel) for rows in parts])
    near = total[:, :-1] / total[:, -1:].clamp_min(1e-12)
    return torch.where(total[:, -1:] > 1e-12, near, solution.units)


def _blurred(values: Tensor, kernel: Tensor) -> Tensor:
    return torch.nn.functional.conv1d(values.T[:, None], kernel[None, None], padding=len(kernel) // 2)[:, 0].T
