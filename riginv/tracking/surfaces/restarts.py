"""Further starts for a scan that is not explained: poses ranked by distance from the scan's points, without a fit."""

import numpy as np
import scipy
import torch
from torch import Tensor

from riginv.tracking.surfaces.fitting import SurfaceFit
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.quality import Quality

POINTS = 200  # of the scan, at most, of unexplained and of other points each
HIDDEN = 0.8  # fraction of a control's squared displacements that is at hidden vertices
MAX_MM = 8.0  # distances are clipped


@torch.no_grad()
def promising_starts(fit: SurfaceFit, target: Target, motion: Motion, found: Quality, poses: Tensor, count: int) -> list[int]:
    """Indices of the `count` poses `(pose, control)` nearest to a scan's unexplained points and as many others.

    Args:
        found: quality of a first fit.
    """
    points = motion.undo(_points(target, found))
    controls = torch.cat([fit.controls(units)[None] for units in poses])
    coefficients = fit.surface.rig.coefficients(controls).float()
    misfits = np.array([_misfit(fit, each, points) for each in coefficients])
    return np.argsort(misfits, kind="stable")[:count].tolist()


@torch.no_grad()
def hidden_controls(fit: SurfaceFit) -> list[int]:
    """Indices of the controls that mostly move parts that are hidden at rest, such as a tongue.

    Gradients do not find them: hidden parts have no closest points on a scan.
    """
    surface, found = fit.surface, []
    rest = surface.vertices(fit.coefficients(fit.neutral))
    for number, neutral in enumerate(fit.neutral.tolist()):
        units = fit.neutral.clone()
        units[number] = 1.0 if neutral < 1 else 0.0
        moved = ((surface.vertices(fit.coefficients(units)) - rest) ** 2).sum(axis=1)
        if moved[~surface.outer].sum() > HIDDEN * max(moved.sum(), 1e-9):
            found.append(number)
    return found


def _points(target: Target, found: Quality) -> np.ndarray:
    rng = np.random.default_rng(0)
    chosen = [rng.permutation(np.flatnonzero(rows))[:POINTS] for rows in (found.unexplained, ~found.unexplained)]
    return target.points[np.concatenate(chosen)]


def _misfit(fit: SurfaceFit, coefficients: Tensor, points: np.ndarray) -> float:
    tree = scipy.spatial.cKDTree(fit.surface.vertices(coefficients), compact_nodes=False, balanced_tree=False)
    return float((np.minimum(tree.query(points, distance_upper_bound=MAX_MM)[0], MAX_MM) ** 2).mean())
