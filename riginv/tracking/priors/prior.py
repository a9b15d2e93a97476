"""A Gaussian over a rig's controls, in fractions of their ranges."""

from dataclasses import dataclass, replace
from functools import cached_property

import scipy
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.solvers.objective import GaussianPrior

RIDGE = 1e-4  # added to every variance: a control that never moved may still move by a hundredth of its range
RADIUS_MM = 6.0  # within which errors of measurements are shared
MAX_POINTS = 4000  # that are counted; more are subsampled


@dataclass(frozen=True)
class ControlPrior:
    """Mean and covariance of a rig's controls; 0 is the lower limit of a control, 1 the upper.

    Attributes:
        names: of the controls, in the rig's order.
        mean: `(control,)`, float64.
        covariance: `(control, control)`, float64, positive definite.
        source: what it was learned from, as text.
        changes: `(control, control)`, float64, positive definite: at f frames a second the second differences of the controls
            from frame to frame have the covariance changes / f^3 (white noise as acceleration); None: not known.
    """

    names: tuple[str, ...]
    mean: Tensor
    covariance: Tensor
    source: str = ""
    changes: Tensor | None = None

    @cached_property
    def precision(self) -> Tensor:
        """The inverse of the covariance, `(control, control)`."""
        return torch.cholesky_inverse(torch.linalg.cholesky(self.covariance))

    @cached_property
    def deviation(self) -> Tensor:
        """Standard deviations `(control,)`."""
        return self.covariance.diagonal().sqrt()

    def weighed(self, noise_mm: float, measurements: float) -> "GaussianPrior":
        """The prior as a cost beside the mean squared distance of some measurements.

        With independent errors of standard deviation `noise_mm` the most likely controls minimise
        `0.5 mean(distance^2) + 0.5 noise_mm^2 / measurements (u - m)' C^-1 (u - m)`.

        Args:
            noise_mm: standard deviation of a measurement's error, mm, what the rig cannot make included.
            measurements: how many independent ones there are (`independent_measurements`).
        """
        return GaussianPrior(self.mean, noise_mm**2 / max(measurements, 1.0) * self.precision)

    def changes_at(self, fps: float, noise_mm: float, measurements: float, smoothness: float) -> Tensor | None:
        """The covariance of second differences for `riginv.solvers.clip.solve_clip`, `(control, control)`; None: not known.

        With `smoothness` as its smoothness the cost is that of the most likely curves beside the measurements of `weighed`.
        """
        return None if self.changes is None else smoothness * max(measurements, 1.0) / (noise_mm**2 * fps**3) * self.changes

    def rescaled(
        self, hidden: Tensor, visible_scale: float, hidden_scale: float, regression_scale: float = 1.0
    ) -> "ControlPrior":
        """The prior with other variances of some controls; what the others say about these, their regression, is kept.

        Args:
            hidden: which controls they are, `(control,)`.
            visible_scale: factor of the covariance of the other controls.
            hidden_scale: factor of the covariance that these have for given values of the others.
            regression_scale: factor of that regression: below 1 for others that are not known exactly.
        """
        across = self.covariance[:, ~hidden]
        explained = across @ torch.linalg.solve(across[~hidden], across.T)
        by = torch.where(hidden, regression_scale, 1.0).double()
        covariance = visible_scale * torch.outer(by, by) * explained + hidden_scale * (self.covariance - explained)
        return replace(self, covariance=(covariance + covariance.T) / 2)

    def subset(self, controls: Tensor) -> "ControlPrior":
        """The marginal prior of some controls, by their indices `(some,)`."""
        names = tuple(self.names[index] for index in controls.tolist())
        changes = None if self.changes is None else self.changes[controls][:, controls]
        return ControlPrior(names, self.mean[controls], self.covariance[controls][:, controls], self.source, changes)


def learn_prior(rig: RigBackend, controls: Tensor, source: str = "", ridge: float = RIDGE) -> ControlPrior:
    """The prior of controls of earlier takes.

    Args:
        controls: `(frame, control)`, in the rig's own units.
        source: where they come from.
        ridge: added to every variance.

    Raises:
        InputError: fewer than two frames, another number of controls, or values that are not finite.
    """
    if controls.ndim != 2 or controls.shape[1] != len(rig.controls) or len(controls) < 2:
        raise InputError(
            f"a prior of rig '{rig.name}' needs controls (frame, {len(rig.controls)}) of at least 2 frames, "
            f"found shape {tuple(controls.shape)}"
        )
    if not bool(torch.isfinite(controls).all()):
        raise InputError(f"a prior of rig '{rig.name}' cannot be learned from controls with NaN or infinite values")
    lower, span = rig.lower.double().cpu(), (rig.upper - rig.lower).double().cpu()
    units = ((controls.double().cpu() - lower) / span).clamp(0, 1)
    mean = units.mean(dim=0)
    covariance = (units - mean).T @ (units - mean) / (len(units) - 1)
    return ControlPrior(rig.control_names, mean, covariance + ridge * torch.eye(len(mean), dtype=torch.float64), source)


def blended(take: ControlPrior, default: ControlPrior, fraction: float = 0.9, least: float = 0.5) -> ControlPrior:
    """A mixture of the prior of a take and a default prior, for what the take does not show.

    Mean and covariance are those of the mixture; a control that hardly moved in the take keeps some variance.

    Args:
        fraction: of the take in the mixture.
        least: lower bound of each standard deviation, relative to the default prior.
    """
    rest = 1 - fraction
    difference = take.mean - default.mean
    covariance = fraction * take.covariance + rest * default.covariance + fraction * rest * torch.outer(difference, difference)
    missing = (least * default.deviation).square() - covariance.diagonal()
    covariance = covariance + torch.diag(missing.clamp_min(0))
    source = "; ".join(filter(None, (take.source, default.source)))
    return ControlPrior(take.names, fraction * take.mean + rest * default.mean, covariance, source)


def independent_measurements(points: Tensor, radius_mm: float = RADIUS_MM) -> float:
    """The number of independent errors of measured points `(point, 3)`, mm: neighbours share theirs.

    Distant points count as 1 each. On a surface the number is its area divided by that of a disc, however densely it is
    sampled, so that a prior has the same effect for a mesh, for a scan of it, and for markers.
    """
    if not len(points):
        return 0.0
    known = points.double().cpu().numpy()
    known = known[:: -(-len(known) // MAX_POINTS)]
    return float((1 / scipy.spatial.cKDTree(known).query_ball_point(known, radius_mm, return_length=True)).sum())
