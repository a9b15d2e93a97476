"""The fit of a rig to one scan: controls and rigid motion by Levenberg-Marquardt, with new correspondences at every step."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.solvers.box_step import box_step, damping_diagonal
from riginv.solvers.objective import GaussianPrior
from riginv.tracking.surfaces.landmarks import LandmarkTerm
from riginv.tracking.surfaces.matching import Pairs, Target, as_tensor, match
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.rig_surface import Posed, RigSurface
from riginv.tracking.surfaces.triangles import TriangleMesh

START_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-6, 1e3
TRIES = 3  # of increasing damping per linearisation
ROTATION, SHIFT_MM = 2.0, 200.0  # units of rigid motion: radians, mm; so large that their box is never left
NOISE = 4.0  # lower bound of the scale, in typical distances of good pairs
KINK_OFFSET = 0.02  # of a control's range, either way from neutral
SIDES_MM = 3.0  # the scale at which sides are chosen
MIDDLE = 0.5  # of the box of rigid motion


@dataclass(frozen=True)
class Schedule:
    """The steps of a fit.

    Attributes:
        steps: at most.
        first_scale_mm, last_scale_mm: scale of Geman and McClure's weights; the last is wider for noisy scans.
        factor: of the scale from step to step.
        max_step: of a control in one step, as a fraction of its range.
        converged: a fit ends at the last scale when no control moves by more, as a fraction of its range.
        degrees: angle between normals beyond which a pair has weight 0.
        sides_at: steps before which controls at a kink are moved to the side that descends.
    """

    steps: int = 22
    first_scale_mm: float = 20.0
    last_scale_mm: float = 0.5
    factor: float = 0.8
    max_step: float = 0.15
    converged: float = 0.002
    degrees: float = 60.0
    sides_at: tuple[int, ...] = ()

    def scale_mm(self, step: int, least_mm: float) -> float:
        """The scale at a step, not below `least_mm`."""
        return max(least_mm, self.first_scale_mm * self.factor**step)


FROM_SCRATCH = Schedule(sides_at=(2, 6, 10, 16))
FROM_POSE = Schedule(first_scale_mm=5.0, sides_at=(2, 6, 10))  # at 20 mm a fit leaves the pose that it starts from
FROM_NEAR = Schedule(steps=5, first_scale_mm=3.0, factor=0.5, converged=0.01)
FINISH = Schedule(steps=10, first_scale_mm=0.5, converged=0.002)


class State(NamedTuple):
    """The state of a fit.

    Attributes:
        units: controls `(control,)` as fractions of their ranges.
        motion: from the rig's frame to the scan's.
    """

    units: Tensor
    motion: Motion


class Normal(NamedTuple):
    """The data term near a state: `0.5 sum(weight residual^2)`, mm^2, with gradient and Gauss-Newton Hessian.

    The first parameters are the controls, the last six, if there is rigid motion, rotation and shift in their units.
    """

    cost: float
    gradient: Tensor
    hessian: Tensor


class SurfaceFit:
    """Fits of one rig to scans.

    Args:
        rig: its surface.
        prior: on the controls; `base` is added to it.
        moves: whether rigid motion is estimated.
        base: ridge, mm^2 for a control that leaves neutral by its whole range.

    Attributes:
        near: the rig's last pose: poses near each other share a search tree.
    """

    near: TriangleMesh | None = None

    def __init__(self, rig: RigSurface, prior: GaussianPrior | None, moves: bool = True, base: float = 1e-6) -> None:
        self.surface, self.moves = rig, moves
        backend = rig.rig
        self.lower = backend.lower.double().cpu()
        self.span = backend.upper.double().cpu() - self.lower
        self.neutral = (backend.neutral_controls.double().cpu() - self.lower) / self.span
        count = len(self.span)
        ridge = base * torch.eye(count, dtype=torch.float64)
        if prior is None:
            self.prior = GaussianPrior(self.neutral, ridge)
        else:
            self.prior = GaussianPrior(prior.mean.double(), prior.precision.double() + ridge)

    def controls(self, units: Tensor) -> Tensor:
        """Controls in their own units, within the limits of the rig."""
        backend = self.surface.rig
        return (self.lower + self.span * units).to(backend.dtype).clamp(backend.lower, backend.upper)

    def fit(self, target: Target, start: State, schedule: Schedule) -> State:
        """Improve a state by the steps of a schedule."""
        state, damping, typical = start, START_DAMPING, 0.0
        for step in range(schedule.steps):
            if step in schedule.sides_at:
                state = self.choose_sides(target, state, schedule)
            last = max(schedule.last_scale_mm, NOISE * typical)
            scale = schedule.scale_mm(step, last)
            state, moved, damping, typical = self.step(target, state, scale, schedule, damping)
            if moved < schedule.converged and scale <= last:
                break
        return state

    def step(
        self, target: Target, state: State, scale_mm: float, schedule: Schedule, damping: float
    ) -> tuple[State, float, float, float]:
        """One step: the new state, the largest change of a control, the next damping, and the typical distance."""
        posed = self.posed(state)
        pairs = match(self.surface, posed, target, state.motion, scale_mm, schedule.degrees)
        near = Linearised(self, state, pairs, target.landmark_term(self.surface, posed, state.motion, scale_mm))
        before = near.normal.cost + float(self.prior.cost(state.units[None]))
        for _ in range(TRIES):
            change = near.step(damping, schedule.max_step)
            after = near.cost(change)
            if after <= before:
                break
            damping = min(damping * 8, MAX_DAMPING)
        else:
            return state, 0.0, damping, pairs.typical_mm
        moved = float(change[: len(state.units)].abs().max())
        return near.after(change), moved, max(damping / 3, MIN_DAMPING), pairs.typical_mm

    def choose_sides(self, target: Target, state: State, schedule: Schedule) -> State:
        """A state whose two-sided controls near neutral, where many have a kink, are on the side with the steeper descent."""
        kinks = (self.neutral > 0) & (self.neutral < 1) & ((state.units - self.neutral).abs() < KINK_OFFSET)
        if not bool(kinks.any()):
            return state
        posed, scale_mm = self.posed(state), max(SIDES_MM, schedule.last_scale_mm)
        pairs = match(self.surface, posed, target, state.motion, scale_mm, schedule.degrees)
        landmarks = target.landmark_term(self.surface, posed, state.motion, scale_mm)
        sides = [torch.where(kinks, self.neutral + offset, state.units) for offset in (KINK_OFFSET, -KINK_OFFSET)]
        both = (Linearised(self, State(units, state.motion), pairs, landmarks) for units in sides)
        rise, fall = (near.normal.gradient[: len(kinks)] for near in both)
        up, down = -rise, fall
        units = torch.where(kinks & (up > 0) & (up >= down), sides[0], state.units)
        return State(torch.where(kinks & (down > 0) & (down > up), sides[1], units), state.motion)

    def posed(self, state: State) -> Posed:
        """The rig's surface at a state, without rigid motion."""
        posed = self.surface.posed(self.coefficients(state.units), self.near)
        self.near = posed.mesh
        return posed

    def coefficients(self, units: Tensor) -> Tensor:
        """The rig's coefficients `(coefficient,)`."""
        with torch.no_grad():
            return self.surface.rig.coefficients(self.controls(units)[None])[0].float()


class Linearised:
    """Residuals of pairs near a state, linear in the rig's coefficients and in rigid motion.

    Those of landmarks, if there are any, follow those of the pairs.

    Attributes:
        residual, weights: of the pairs, `(pair,)`.
        columns: derivatives of the residuals by controls and rigid motion, `(pair, control + motion)`.
        normal: the normal equations.
    """

    def __init__(self, fit: SurfaceFit, state: State, pairs: Pairs, landmarks: LandmarkTerm | None = None) -> None:
        self.fit, self.state = fit, state
        self.rows = pairs.rows(fit.surface)
        self.residual, self.weights = as_tensor(pairs.residual), as_tensor(pairs.weights)
        if landmarks is not None:
            self.rows = torch.cat([self.rows, landmarks.rows])
            self.residual = torch.cat([self.residual, as_tensor(landmarks.residual)])
            self.weights = torch.cat([self.weights, as_tensor(landmarks.weights)])
        self.coefficients, jacobian = fit.surface.linearise(fit.controls(state.units))
        columns = jacobian.times(self.rows) * fit.span.float()
        if fit.moves:
            box = np.array([ROTATION] * 3 + [SHIFT_MM] * 3)
            by_motion = pairs.motion_rows(fit.surface.centre)
            if landmarks is not None:
                by_motion = np.concatenate([by_motion, landmarks.motion_rows])
            self.motion_rows = as_tensor(by_motion * box)
            columns = torch.cat([columns, self.motion_rows], dim=1)
        self.columns = columns
        weighted = self.weights[:, None] * columns
        cost = 0.5 * float(self.weights @ self.residual.square())
        self.normal = Normal(cost, (weighted.T @ self.residual).double(), (weighted.T @ columns).double())

    def step(self, damping: float, max_step: float) -> Tensor:
        """The step `(control + motion,)` of the quadratic model, within the limits of the controls."""
        prior, count = self.fit.prior, len(self.state.units)
        hessian, gradient = self.normal.hessian.clone(), self.normal.gradient.clone()
        hessian[:count, :count] += prior.precision
        gradient[:count] += prior.gradient(self.state.units[None])[0]
        at = torch.cat([self.state.units, torch.full((len(gradient) - count,), MIDDLE, dtype=torch.float64)])
        added = damping_diagonal(hessian[None], torch.tensor([damping], dtype=torch.float64))
        return box_step(hessian[None], gradient[None], at[None], added)[0].clamp(-max_step, max_step)

    def cost(self, change: Tensor) -> float:
        """The objective after a step, with the same pairs: exact in the controls, linear in rigid motion."""
        count = len(self.state.units)
        units = self.state.units + change[:count]
        residual = self.residual + self.rows @ (self.fit.coefficients(units) - self.coefficients)
        if self.fit.moves:
            residual = residual + self.motion_rows @ change[count:].float()
        return 0.5 * float(self.weights @ residual.square()) + float(self.fit.prior.cost(units[None]))

    def after(self, change: Tensor) -> State:
        count = len(self.state.units)
        motion = self.state.motion
        if self.fit.moves:
            rotation, shift = change[count : count + 3].numpy() * ROTATION, change[count + 3 :].numpy() * SHIFT_MM
            motion = motion.after(rotation, shift, self.fit.surface.centre)
        return State((self.state.units + change[:count]).clamp(0, 1), motion)
