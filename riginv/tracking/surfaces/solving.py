"""The solver of single scans: starts, restarts, and flags."""

from dataclasses import dataclass, field, replace

import numpy as np
import torch

from riginv.rig.interface import LinearRig
from riginv.solvers.objective import GaussianPrior
from riginv.tracking.priors.performances import STRONG, PoseLibrary
from riginv.tracking.priors.prior import ControlPrior, independent_measurements
from riginv.tracking.surfaces.alignment import Aligner
from riginv.tracking.surfaces.fitting import FINISH, FROM_NEAR, FROM_POSE, FROM_SCRATCH, Schedule, State, SurfaceFit
from riginv.tracking.surfaces.landmarks import Landmarks
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.quality import Quality, quality
from riginv.tracking.surfaces.restarts import hidden_controls, promising_starts
from riginv.tracking.surfaces.rig_surface import RigSurface
from riginv.tracking.surfaces.triangles import Surface

DEVIATION = 1.2533  # of a Gaussian, relative to its mean distance from 0
MARGIN = 0.02  # of a control's range between a start and its limits


@dataclass(frozen=True)
class ScanSettings:
    """Settings of the solver.

    Attributes:
        samples: number of samples of the rig's skin, and of the scan.
        fine_samples: of the scan in the last steps, where more of them lower the effect of noise.
        noise_mm: standard deviation of the residual between the scan and the rig's best mesh, which weights the prior.
        base: mm^2 for a control that leaves neutral by its whole range, beside the prior.
        from_scratch, from_pose, from_near, finish: the steps of a fit.
        explained: fraction of explained points below which further starts are tried.
        starts: number of these for each ranking of poses: near the solution, and near the prior's mean.
        hidden_starts: for each ranking of poses with hidden parts shown.
        seen: the fraction of the rig's skin below which a frame is flagged as `little_seen`.
        lost_mm: mean distance of a scan from the rig above which a frame is flagged as `lost`.
        unexplained: the fraction of a scan's points, explained, below which a frame is flagged as `unexplained`.
        ambiguous_mm: posterior standard deviation of the skin's vertices above which it is flagged as `ambiguous`.
    """

    samples: int = 1500
    fine_samples: int = 4000
    noise_mm: float = 0.1
    base: float = 1e-6
    from_scratch: Schedule = FROM_SCRATCH
    from_pose: Schedule = FROM_POSE
    from_near: Schedule = FROM_NEAR
    finish: Schedule = FINISH
    explained: float = 0.99
    starts: int = 1
    hidden_starts: int = 4
    seen: float = 0.25
    lost_mm: float = 1.0
    unexplained: float = 0.95
    ambiguous_mm: float = 0.7


@dataclass(frozen=True)
class SolvedScan:
    """The solution of one scan.

    Attributes:
        state: controls and rigid motion.
        quality: how well they explain it.
        turned: whether it was aligned only after a rotation by right angles.
    """

    state: State
    quality: Quality
    turned: bool = False


@dataclass
class ScanSolver:
    """Solves scans of one rig.

    Attributes:
        rig: the rig.
        prior: on its controls.
        settings: of the solver.
        moves: whether rigid motion is estimated.
        stability: weight of each vertex in the alignment, `(vertex,)`; None: equal.
    """

    rig: LinearRig
    prior: ControlPrior
    settings: ScanSettings = field(default_factory=ScanSettings)
    moves: bool = True
    stability: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.surface = RigSurface(self.rig, self.settings.samples, self.stability)
        self.start = self.prior.mean.clamp(MARGIN, 1 - MARGIN)
        first = self.fit_of(1.0)
        mesh, outer = self.surface.posed(first.coefficients(self.start)).mesh, np.flatnonzero(self.surface.outer)
        self.aligner = Aligner(mesh, outer, self.surface.sampled, self.surface.stability)
        self.library = PoseLibrary.of(self.rig)
        self.hidden, self.fit_neutral = hidden_controls(first), first.neutral

    def target(self, surface: Surface, landmarks: Landmarks | None = None) -> Target:
        return Target.of(surface, self.settings.samples, landmarks=landmarks)

    def finer(self, target: Target) -> Target:
        """The same scan with the samples of the last steps."""
        return Target.of(target.surface, self.settings.fine_samples, landmarks=target.landmarks)

    def fit(self, target: Target, found: SolvedScan | None = None) -> SurfaceFit:
        """The fit of a scan, with the prior weighted for its measurements.

        Args:
            found: a solution, whose distances from the scan show how noisy it is; None: as noisy as the settings say.
        """
        measurements, noise_mm = independent_measurements(torch.from_numpy(target.points)), self.settings.noise_mm
        if found is not None:  # noise is independent from point to point, unlike what the rig cannot make
            white = DEVIATION * float(np.nan_to_num(found.quality.scan_mm))
            noise_mm = float(np.hypot(noise_mm, white * (measurements / len(target.surface.points)) ** 0.5))
        return self.fit_of(measurements, noise_mm)

    def variance_per_measurement(self, target: Target) -> float:
        """The weight of the prior for a scan, mm^2."""
        return self.settings.noise_mm**2 / max(independent_measurements(torch.from_numpy(target.points)), 1)

    def fit_of(self, measurements: float, noise_mm: float | None = None) -> SurfaceFit:
        """The fit of a scan with a number of independent measurements, and a noise; None: that of the settings."""
        weighed: GaussianPrior = self.prior.weighed(noise_mm or self.settings.noise_mm, measurements)
        return SurfaceFit(self.surface, weighed, self.moves, self.settings.base)

    def solve(self, target: Target, before: SolvedScan | None = None) -> SolvedScan:
        """Solve a scan, from the frame before if there is one.

        If the solution does not explain the scan, it is solved from scratch, and then from the most promising of some poses.
        The best solution by robust distance and prior is kept.
        """
        fit = self.fit(target)
        best: SolvedScan | None = None
        if before is not None:
            best = self._try(fit, target, before.state, self.settings.from_near)
            expected = min(self.settings.explained, before.quality.explained - 0.01)
            if best.quality.explained >= expected:
                return best
        motion, turned = Motion.identity(), False
        if self.moves:
            aligned = self.aligner.align(target)
            motion, turned = aligned.motion, aligned.turned
        fresh = self._try(fit, target, State(self.start, motion), self.settings.from_scratch)
        best = self._better(best, replace(fresh, turned=turned))
        if best.quality.explained < self.settings.explained and self.settings.starts:
            best = self._restart(fit, target, best)
        return best

    def finished(self, target: Target, found: SolvedScan) -> SolvedScan:
        """A solution after the last steps, with more of the scan's points and with a prior as strong as they are noisy."""
        finer = self.finer(target)
        state = self.fit(finer, found).fit(finer, found.state, self.settings.finish)
        return replace(found, state=state, quality=quality(self.fit(target), target, state))

    def _restart(self, fit: SurfaceFit, target: Target, best: SolvedScan) -> SolvedScan:
        motion, found = best.state.motion, best.quality
        fresh = self.library.around(self.start)
        few, more = self.settings.starts, self.settings.hidden_starts
        ranked = [(self.library.around(best.state.units), fresh, few), (fresh, fresh, few)]
        for number in self.hidden:  # no derivative leads to them, and what they hide must give way, such as a jaw
            shown = self.start.clone()
            shown[number] = STRONG if self.fit_neutral[number] < 1 else 1 - STRONG
            poses = self.library.around(shown)
            ranked.append((poses, poses, more))
        for poses, starts, count in ranked:
            for number in promising_starts(fit, target, motion, found, poses, count):
                best = self._better(best, self._try(fit, target, State(starts[number], motion), self.settings.from_pose))
        return best

    def _try(self, fit: SurfaceFit, target: Target, start: State, schedule: Schedule) -> SolvedScan:
        state = fit.fit(target, start, schedule)
        return SolvedScan(state, quality(fit, target, state))

    @staticmethod
    def _better(one: SolvedScan | None, other: SolvedScan) -> SolvedScan:
        return other if one is None or other.quality.objective < one.quality.objective else one

    def flags(self, found: SolvedScan) -> list[str]:
        """The flags of a frame: `lost`, `unexplained`, `little_seen`."""
        named = {
            "lost": not found.quality.scan_mm < self.settings.lost_mm or found.quality.explained < 0.5,
            "unexplained": found.quality.explained < self.settings.unexplained,
            "little_seen": found.quality.seen < self.settings.seen,
        }
        return [name for name, holds in named.items() if holds]
