"""Labels of markers that were exchanged, and stray markers: found by a robust fit, and corrected or left out."""

from typing import NamedTuple

import numpy as np
import scipy
import torch
from torch import Tensor

from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.levenberg_marquardt import Solution
from riginv.tracking.alternation import interpolate_controls
from riginv.tracking.markers.objective import MarkerObjective, pack

LIMIT = 8.0  # typical distances, beyond which a marker is suspected
LEAST = 10.0  # times the noise: the least limit
ROUNDS, STEPS = 3, 8  # of robust reweighting
BETTER = 0.5  # factor of the distance, that an exchange must reach


class Labelled(NamedTuple):
    """Observed markers with mended labels.

    Attributes:
        points: `(frame, marker, 3)`, mm; NaN in gaps.
        swapped: whether a marker carried another's label, `(frame, marker)`.
        stray: whether it lies where no marker of the rig does: it is left out, `(frame, marker)`.
        units: improved controls `(frame, control)`.
    """

    points: Tensor
    swapped: Tensor
    stray: Tensor
    units: Tensor

    @property
    def weights(self) -> Tensor:
        """`(frame, marker)`: 0 for stray markers."""
        return (~self.stray).float()


def mend_labels(objective: MarkerObjective, points: Tensor, units: Tensor, noise_mm: float, numbers: Tensor) -> Labelled:
    """Exchange labels back, and find stray markers.

    Args:
        points: observed markers `(frame, marker, 3)`, mm.
        units: controls `(frame, control)` fitted to them, which exchanged labels have pulled away.
        noise_mm: standard deviation of a marker's error.
        numbers: frame numbers `(frame,)`.
    """
    points, units = points.clone(), units.clone()
    swapped, stray = (torch.zeros(points.shape[:2], dtype=torch.bool) for _ in range(2))
    distance = _distance(objective, units, pack(points))
    limit, typical = _limit(distance, noise_mm)
    rows = ((distance > limit).sum(dim=1) > 0).nonzero()[:, 0]
    if not len(rows):
        return Labelled(points, swapped, stray, units)
    units[rows] = _robust(objective, points, units, rows, typical, numbers)
    labels = objective.residuals(units[rows], pack(points[rows]).nan_to_num(0.0))
    rotation, translation = labels.motion
    expected = labels.points @ rotation.mT + translation[:, None]
    for row, aims in zip(rows.tolist(), expected):
        points[row], swapped[row] = _exchange(points[row], aims, limit)
    stray[rows] = (points[rows] - expected).norm(dim=2) > limit  # comparisons with NaN are false
    mended = Labelled(points, swapped, stray, units)
    start = refine_meshes(objective, pack(points[rows], mended.weights[rows]), units[rows], STEPS)
    units[rows] = torch.where(start.skipped[:, None], units[rows], start.units)
    return mended


@torch.no_grad()
def _distance(objective: MarkerObjective, units: Tensor, packed: Tensor) -> Tensor:
    """Distances `(frame, marker)`, mm, of observed markers from the rig's; NaN where unknown."""
    found = objective.residuals(units, packed.nan_to_num(0.0))
    return torch.where(found.weights > 0, found.residual.norm(dim=2), torch.nan)


def _limit(distance: Tensor, noise_mm: float) -> tuple[float, float]:
    """The distance from which a marker is suspected, and the typical one."""
    typical = float(distance.nanmedian().nan_to_num(0.0))
    return max(LIMIT * typical, LEAST * noise_mm), max(typical, noise_mm)


def _robust(objective: MarkerObjective, points: Tensor, units: Tensor, rows: Tensor, typical: float, numbers: Tensor) -> Tensor:
    """Controls of suspected frames with the weights of Geman and McClure, from their own and from neighbours' solutions."""
    good = torch.ones(len(units), dtype=torch.bool)
    good[rows] = False
    starts = [units[rows]]
    if bool(good.any()):
        starts.append(interpolate_controls(units, good, numbers)[rows].to(units))
    best: Solution | None = None
    for start in starts:
        at = start
        for scale in np.geomspace(12.0, 3.0, ROUNDS) * typical:
            distance = _distance(objective, at, pack(points[rows]))
            weights = (1 / (1 + (distance / scale) ** 2) ** 2).nan_to_num(0.0)
            solution = refine_meshes(objective, pack(points[rows], weights.clamp_min(1e-6)), at, STEPS)
            at = torch.where(solution.skipped[:, None], at, solution.units)
        distance = _distance(objective, at, pack(points[rows]))
        robust = (distance.square() / (1 + (distance / (3 * typical)) ** 2)).nansum(dim=1)
        found = Solution(at, robust, torch.ones_like(robust, dtype=torch.bool), torch.zeros_like(robust).long(), robust < 0)
        if best is None:
            best = found
        else:
            best.take_better(slice(None), found)
    assert best is not None
    return best.units


def _exchange(points: Tensor, expected: Tensor, limit: float) -> tuple[Tensor, Tensor]:
    """Observations `(marker, 3)` with exchanged labels set right, and which of them came from another label, `(marker,)`.

    Suspects may have another suspect's label, or that of a marker which is in a gap.
    """
    result, swapped = points.clone(), torch.zeros(len(points), dtype=torch.bool)
    distance = (points - expected).norm(dim=1)
    suspects, gaps = (distance > limit).nonzero()[:, 0], distance.isnan().nonzero()[:, 0]
    open_labels = torch.cat([suspects, gaps])
    costs = torch.cdist(expected[open_labels].double(), points[suspects].double())
    aims, given = scipy.optimize.linear_sum_assignment(costs.numpy())
    moves = []
    for aim, row in zip(aims.tolist(), given.tolist()):
        label, taken = int(open_labels[aim]), int(suspects[row])
        if label != taken and costs[aim, row] < min(limit, BETTER * float(distance[taken])):
            moves.append((label, taken))
    result[[taken for _, taken in moves]] = torch.nan
    for label, taken in moves:
        result[label], swapped[label] = points[taken], True
    return result, swapped
