"""What a scan does not determine: controls that it leaves where the prior has them, and how unsure the mesh is."""

from typing import NamedTuple

import numpy as np
import torch

from riginv.tracking.surfaces.clip import eliminate_motion
from riginv.tracking.surfaces.fitting import Linearised
from riginv.tracking.surfaces.matching import Target, match
from riginv.tracking.surfaces.solving import ScanSolver, SolvedScan

LEFT_OPEN = 0.9  # of the prior's standard deviation, that remains of a control which a scan does not determine
VERTICES = 300  # of the skin, that the deviation of the mesh is taken at
MATTERS_MM = (
    0.2  # root mean square over the vertices that a control moves, for one standard deviation; fainter ones are not named
)


class Uncertainty(NamedTuple):
    """What is unsure about one frame, by the Hessian at its answer.

    Attributes:
        remaining: of each control's standard deviation before the scan was seen, `(control,)`: 1 where the scan tells nothing.
        skin_mm: standard deviation of the skin's vertices, root mean square.
    """

    remaining: np.ndarray
    skin_mm: float


def uncertainty(solver: ScanSolver, target: Target, found: SolvedScan) -> Uncertainty:
    """The posterior of a frame's controls, as a Gaussian around its answer."""
    fit, schedule = solver.fit(target), solver.settings.from_near
    posed = fit.surface.posed(fit.coefficients(found.state.units))
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
    """The names of the controls that scans leave open in most frames, and that would move the mesh."""
    if not seen:
        return []
    remaining = np.median([each.remaining for each in seen], axis=0)
    return [
        name
        for name, share, matters in zip(solver.rig.control_names, remaining, _matters(solver))
        if share > LEFT_OPEN and matters
    ]


def _skin_columns(solver: ScanSolver, found: SolvedScan) -> torch.Tensor:
    """How controls move vertices of the skin, `(3 vertices, control)`, mm for their whole range."""
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
