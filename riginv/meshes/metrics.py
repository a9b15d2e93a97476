"""Metrics: vertex errors in mm, and the roughness of curves (paper, Tables 1 to 3)."""

import torch
from torch import Tensor

from riginv.rig.interface import RigBackend

AT_NEUTRAL = 1e-3  # a control within this fraction of its range from neutral counts as neutral


def mean_distance(found: Tensor, expected: Tensor, known: Tensor | None = None) -> Tensor:
    """The mean vertex distance of each mesh, `(mesh,)`, mm; arguments as in `VertexError.update`."""
    distances = torch.linalg.vector_norm(found - expected, dim=2)
    if known is None:
        return distances.mean(dim=1)
    return torch.where(known, distances, 0.0).sum(dim=1) / known.sum(dim=1).clamp_min(1)


def roughness(controls: Tensor, numbers: Tensor | None = None) -> float:
    """The mean squared second difference of curves `(frame, control)` (paper, Table 3); NaN without three consecutive frames.

    Args:
        numbers: frame numbers `(frame,)`: second differences across missing frames are left out; None: none is missing.
    """
    squares = (controls[2:] - 2 * controls[1:-1] + controls[:-2]).square()
    if numbers is not None and len(squares):
        steps = numbers.diff()
        squares = squares[(steps[1:] == steps.median()) & (steps[:-1] == steps.median())]
    return float(squares.mean())


def nonzero_controls(controls: Tensor, rig: RigBackend) -> float:
    """The number of controls `(frame, control)` that are not neutral, averaged over frames."""
    away = (controls - rig.neutral_controls).abs() > AT_NEUTRAL * (rig.upper - rig.lower)
    return float(away.sum(dim=1).double().mean())
