"""Other starts for a scan that is not explained: poses judged by the scan's points, without any fit."""

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from riginv.surfaces.fitting import SurfaceFit
from riginv.surfaces.matching import Target
from riginv.surfaces.motion import Motion
from riginv.surfaces.quality import Quality

POINTS = 200  # of the scan, unexplained ones and as many others, at most
CUT_MM = 8.0  # at which a distance is cut off


@torch.no_grad()
def promising(
    fit: SurfaceFit, target: Target, motion: Motion, found: Quality, poses: Tensor, count: int
) -> list[Tensor]:
    """The `count` of some poses `(pose, control)` that come nearest to a scan, its unexplained points above all.

    Args:
        found: what a first fit left unexplained.
    """
    points = motion.undo(_points(target, found))
    controls = torch.cat([fit.controls(units)[None] for units in poses])
    coefficients = fit.surface.rig.coefficients(controls).float()
    misfits = np.array([_misfit(fit, each, points) for each in coefficients])
    return [poses[number] for number in np.argsort(misfits, kind="stable")[:count]]


def _points(target: Target, found: Quality) -> np.ndarray:
    rng = np.random.default_rng(0)
    chosen = [rng.permutation(np.flatnonzero(rows))[:POINTS] for rows in (found.unexplained, ~found.unexplained)]
    return target.points[np.concatenate(chosen)]


def _misfit(fit: SurfaceFit, coefficients: Tensor, points: np.ndarray) -> float:
    tree = cKDTree(fit.surface.vertices(coefficients), compact_nodes=False, balanced_tree=False)
    return float((np.minimum(tree.query(points, distance_upper_bound=CUT_MM)[0], CUT_MM) ** 2).mean())
