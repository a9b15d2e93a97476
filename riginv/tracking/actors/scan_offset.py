"""A static offset of the rig's surface, found together with the controls and the rigid motion of a few scans.

The sum over the scans of the robust squared distance along normals, the priors of the controls and an L1 penalty on them, plus
the bending of the offset, is minimised. In every iteration the correspondences are fixed, and one Gauss-Newton step is taken
for all of it at once: the frames are eliminated from the normal equations, as in `riginv.solvers.offset`. The offset is a
combination of the skin's smoothest displacements; loose parts, such as eyeballs, follow the skin near them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
import torch
from torch import Tensor

from riginv.solvers.objective import sparsity_terms
from riginv.solvers.offset import Arrow
from riginv.tracking.surfaces.fitting import ROTATION, SHIFT_MM, Linearised, Schedule, State, SurfaceFit
from riginv.tracking.surfaces.matching import Pairs, Target, as_tensor, match
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.solving import ScanSolver
from riginv.tracking.surfaces.wrap import skin_component, smoothness_matrix, with_loose_parts

ROUNDS = Schedule(steps=20, last_scale_mm=1.0)


@dataclass(frozen=True)
class ScanOffsetSettings:
    """Settings of the search for an offset.

    Attributes:
        frames: scans spread over the clip.
        modes: of the skin's smoothest displacements, in each axis.
        schedule: its steps, of matching and solving each, its scales and angle; no other of its settings is used.
        sparsity: mm^2, an L1 penalty on the controls, without which the neutral pose would be ambiguous.
        stiffness: of the offset, relative to the data term of one scan of all vertices.
        damping: of the controls.
    """

    frames: int = 24
    modes: int = 150
    schedule: Schedule = ROUNDS
    sparsity: float = 3e-5
    stiffness: float = 0.2
    damping: float = 1e-2


RIDGE = 1e-2  # added to the smoothness of each mode: what no scan determines stays the rig's


class ScanOffset:
    """The search for the offset of an actor from a rig.

    Attributes:
        modes: displacements of the skin, `(vertex, mode)`, 0 at loose parts.
        stiffness: the cost of each coefficient of the field, `(3 mode,)`.
    """

    def __init__(self, solver: ScanSolver, settings: ScanOffsetSettings) -> None:
        self.solver, self.settings = solver, settings
        surface = solver.surface
        self.rest = solver.rig.rest_vertices.cpu().double().numpy()
        self.skin = skin_component(self.rest, surface.faces, np.flatnonzero(surface.outer))
        matrix = smoothness_matrix(surface.faces, self.skin)
        count = min(settings.modes, matrix.shape[0] - 2)
        stiffness, vectors = scipy.sparse.linalg.eigsh(matrix, count, sigma=-1e-3, v0=np.ones(matrix.shape[0]))
        self.modes = np.zeros((len(self.rest), count))
        self.modes[self.skin] = vectors
        self.stiffness = torch.from_numpy(np.repeat(settings.stiffness / len(vectors) * (stiffness + RIDGE), 3))

    def solve(self, targets: Sequence[Target]) -> np.ndarray:
        """The actor's neutral `(vertex, 3)`, mm, in the rig's space up to a rigid motion.

        Args:
            targets: scans, at least one.
        """
        solver, settings = self.solver, self.settings
        fits = [solver.fit(target) for target in targets]
        aligned = [solver.aligner.align(target).motion if solver.moves else Motion.identity() for target in targets]
        states = [State(solver.start, motion) for motion in aligned]
        field = torch.zeros(len(self.stiffness), dtype=torch.float64)
        for step in range(settings.schedule.steps):
            scale_mm = settings.schedule.scale_mm(step, settings.schedule.last_scale_mm)
            surface = solver.surface.with_rest(self.neutral(field))
            for fit in fits:
                fit.surface = surface
            arrow = self._linearise(fits, targets, states, field, scale_mm)
            found = arrow.step(torch.stack([state.units for state in states]), settings.damping)
            if found is None:
                break
            units, motion, shared = found
            field = field + shared
            states = [State(*moved) for moved in zip(units, self._moved(states, motion))]
        return self.neutral(field)

    def neutral(self, field: Tensor) -> np.ndarray:
        """The mesh at rest `(vertex, 3)` with a field `(3 mode,)`."""
        displacement = self.modes @ field.numpy().reshape(-1, 3)
        return self.rest + with_loose_parts(self.rest, self.solver.surface.faces, self.skin, displacement)

    def _linearise(
        self, fits: list[SurfaceFit], targets: Sequence[Target], states: list[State], field: Tensor, scale_mm: float
    ) -> Arrow:
        """The normal equations of all frames and the field near a state."""
        own, slope = torch.diag(self.stiffness), self.stiffness * field
        blocks, gradients, couplings = [], [], []
        for fit, target, state in zip(fits, targets, states):
            posed = fit.posed(state)
            pairs = match(fit.surface, posed, target, state.motion, scale_mm, self.settings.schedule.degrees)
            near, columns = Linearised(fit, state, pairs), self._columns(pairs)
            weighted = near.weights[:, None] * columns
            own = own + (columns.T @ weighted).double()
            slope = slope + (weighted.T @ near.residual).double()
            couplings.append((near.columns.T @ weighted).double())
            block, force = near.normal.hessian.clone(), near.normal.gradient.clone()
            count = len(state.units)
            _, sparse, curvature = sparsity_terms(state.units[None], fit.neutral, self.settings.sparsity)
            block[:count, :count] += fit.prior.precision + torch.diag(curvature[0])
            force[:count] += fit.prior.gradient(state.units[None])[0] + sparse[0]
            blocks.append(block)
            gradients.append(force)
        hessian, gradient, coupling = (torch.stack(each) for each in (blocks, gradients, couplings))
        return Arrow(hessian, gradient, coupling, own, slope, len(states[0].units))

    def _columns(self, pairs: Pairs) -> Tensor:
        """Derivatives of the pairs' residuals by the field, `(pair, 3 mode)`."""
        modes = (pairs.barycentric[..., None] * self.modes[pairs.corners]).sum(axis=1)
        return as_tensor((modes[:, :, None] * pairs.normals[:, None]).reshape(len(modes), -1))

    def _moved(self, states: list[State], motion: Tensor | None) -> list[Motion]:
        """The rigid motion of each frame after a step `(frame, 6)`."""
        if motion is None:
            return [state.motion for state in states]
        centre, steps = self.solver.surface.centre, motion.numpy()
        return [state.motion.after(step[:3] * ROTATION, step[3:] * SHIFT_MM, centre) for state, step in zip(states, steps)]
