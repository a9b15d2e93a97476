"""Uncertainty of a fit to a scan: controls that stay at the prior, and the posterior deviation of the mesh."""

from typing import NamedTuple

import numpy as np
import torch

from riginv.tracking.surfaces.clip import eliminate_motion
from riginv.tracking.surfaces.fitting import Linearised
from riginv.tracking.surfaces.matching import Target, match
from riginv.tracking.surfaces.solving import ScanSolver, SolvedScan

UNDETERMINED = 0.9  # remaining fraction of the prior's standard deviation of a control that a scan does not determine
VERTICES = 300  # of the skin, at which the deviation of the mesh is measured
MATTERS_MM = 0.2  # root mean square displacement by one standard deviation; weaker controls are not reported


class Uncertainty(NamedTuple):
    """The uncertainty of a frame, from the Hessian at its solution.

    Attributes:
        remaining: posterior relative to prior standard deviation of each control, `(control,)`: 1 where the scan adds nothing.
        skin_mm: standard deviation of the skin's vertices, root mean square.
    """

    remaining: np.ndarray
    skin_mm: float


def uncertainty(solver: ScanSolver, target: Target, found: SolvedScan) -> Uncertainty:
    """The uncertainty of a solution: a Gaussian posterior of the controls."""
    fit, schedule = solver.fit(target), solver.settings.from_near
    posed = fit.posed(found.state)
    scale = max(schedule.last_scale_mm, 5 * found.quality.scan_mm)
    near = Linearised(fit, found.state, match(fit.surface, posed, target, found.state.motion, scale, schedule.degrees))
    each = solver.variance_per_measurement(target)
    covariance = each * torch.linalg.inv(eliminate_motion(fit, near).hessian)
    before = each * torch.linalg.inv(fit.prior.precision)
    remaining = (covariance.diagonal().clamp_min(0) / before.diagonal()).sqrt().numpy()
    columns = _skin_columns(solver, found)
    variance = torch.einsum("rc,cd,rd->r", columns, covariance, columns)
    return Uncertainty(remaining, float((3 * variance.clamp_min(0).mean()).sqrt()))


def open_controls(solver: ScanSolver, seen: list[Uncertainty]) -> list[str]:
    """The names of controls that most scans do not determine, and that move the mesh."""
    if not seen:
        return []
    remaining = np.median([each.remaining for each in seen], axis=0)
    return [
        name
        for name, fraction, matters in zip(solver.rig.control_names, remaining, _matters(solver))
        if fraction > UNDETERMINED and matters
    ]


def _skin_columns(solver: ScanSolver, found: SolvedScan) -> torch.Tensor:
    """Derivatives of skin vertices by the controls, `(3 vertices, control)`, mm for a whole range."""
    surface, fit = solver.surface, solver.fit_of(1.0)
    some = np.repeat(surface.sampled[:: max(1, len(surface.sampled) // VERTICES)], 3)
    axes = np.tile(np.eye(3), (len(some) // 3, 1))
    rows = surface.rows(some[:, None], np.ones((len(some), 1)), axes)
    _, jacobian = surface.linearise(fit.controls(found.state.units))
    return jacobian.times(rows).double() * fit.span


def _matters(solver: ScanSolver) -> list[bool]:
    fit, found = solver.fit_of(1.0), []
    start = solver.start
    rest = solver.surface.vertices(fit.coefficients(start))
    for number, deviation in enumerate(solver.prior.deviation.tolist()):
        units = start.clone()
        units[number] = (units[number] + deviation).clamp(0, 1)
        moved = ((solver.surface.vertices(fit.coefficients(units)) - rest) ** 2).sum(axis=1)
        found.append(bool(np.sqrt(moved[moved > 1e-6].mean() if (moved > 1e-6).any() else 0.0) > MATTERS_MM))
    return found
