"""Estimators of controls from filled meshes without rigid motion: a network, a solver, or a network and then a solver."""

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterator

import torch
from torch import Tensor

from riginv.geometry.kinematics import remove_motion
from riginv.inference.inverse import Inverse, QuickEncoder
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.every_mesh import EXACT, refine_meshes, solve_frames, solve_from_guess
from riginv.solvers.fewer_controls import with_fewer_controls
from riginv.solvers.levenberg_marquardt import levenberg_marquardt
from riginv.solvers.objective import Objective
from riginv.solvers.starts import first_start
from riginv.tracking.actors.actor import ActorRig
from riginv.tracking.constraints import ControlConstraints
from riginv.tracking.fixed_controls import FixedControlsRig

BATCH_SIZE = 512  # meshes per network call
DISTANCE_STEPS = 2  # of a network, from controls of a slightly different mesh
UPDATE_STEPS = 3  # solver steps from controls of a slightly different mesh
MOSTLY = 0.9  # of the frames of a clip: so many that are exact make it one of the rig's own
UNCONVERGED_MM = 0.02  # root mean square distance that a further solver step would gain


class ControlEstimator(ABC):
    """Maps filled meshes `(frame, vertex, 3)`, mm, to controls `(frame, control)`; rigid `motion`, if any, is removed first.

    Attributes:
        frames_are_independent: whether the controls of a frame do not depend on the others.
        tolerance_mm: mean vertex displacement by an iteration of rigid motion and controls, below which a frame is finished.
        has_final_steps: whether `finish` follows.
    """

    frames_are_independent = False
    tolerance_mm = 0.01
    has_final_steps = False

    @abstractmethod
    def estimate(self, vertices: Tensor, motion: Tensor | None = None) -> Tensor:
        """The controls of consecutive frames."""

    @abstractmethod
    def refine(self, vertices: Tensor, controls: Tensor, motion: Tensor | None = None) -> Tensor:
        """The controls of meshes that changed a little since `controls` were estimated."""

    def finish(self, vertices: Tensor, controls: Tensor) -> Tensor:
        """The final controls of filled meshes without rigid motion, once that is known; only with `has_final_steps`."""
        return controls

    @abstractmethod
    def converged(self, vertices: Tensor, controls: Tensor) -> Tensor:
        """Whether further steps would not lower the error, `(frame,)`."""


class NetworkEstimator(ControlEstimator):
    """The network alone; fixed controls replace its answers.

    Args:
        rig: of the meshes: the network's, or that of an actor.
        mean_steps: steps on the mean vertex distance at the end.
    """

    frames_are_independent = True
    tolerance_mm = 0.03  # each iteration makes a tenth of the last one's displacement, and the network errs by far more

    def __init__(self, inverse: Inverse, constraints: ControlConstraints, rig: RigInMeshSpace, mean_steps: int = 0) -> None:
        self.inverse, self.constraints = inverse, constraints
        self.mean_steps, self.has_final_steps = mean_steps, mean_steps > 0
        self.scale = rig.source.scale if isinstance(rig.source, ActorRig) else 1.0
        self.encode = inverse.encoder if rig is inverse.network.rig else QuickEncoder(rig, rounded=False)
        _ = self.encode.sparse, inverse.packed  # before threads use them

    @torch.no_grad()
    def estimate(self, vertices: Tensor, motion: Tensor | None = None) -> Tensor:
        controls = torch.cat([self.inverse.answer(batch) for batch in self._encoded(vertices, motion)])
        return torch.where(self.constraints.free, controls, self.constraints.values)

    def refine(self, vertices: Tensor, controls: Tensor, motion: Tensor | None = None) -> Tensor:
        if not self.inverse.has_distance_steps:
            return self.estimate(vertices, motion)
        batches = zip(self._encoded(vertices, motion), controls.split(BATCH_SIZE))
        refined = torch.cat([self.inverse.after_distance_steps(*batch, DISTANCE_STEPS) for batch in batches])
        return torch.where(self.constraints.free, refined, self.constraints.values)

    def _encoded(self, vertices: Tensor, motion: Tensor | None = None) -> Iterator[Tensor]:
        """The mesh coordinates of batches."""
        motions = itertools.repeat(None) if motion is None else motion.split(BATCH_SIZE)
        return (self.encode(*batch) / self.scale for batch in zip(vertices.split(BATCH_SIZE), motions))

    def finish(self, vertices: Tensor, controls: Tensor) -> Tensor:
        coordinates = torch.cat(list(self._encoded(vertices)))
        return self.inverse.after_mean_steps(coordinates, controls, self.mean_steps, ~self.constraints.free)

    def converged(self, vertices: Tensor, controls: Tensor) -> Tensor:
        return torch.ones(len(vertices), dtype=torch.bool)


class SolverEstimator(ControlEstimator):
    """Levenberg-Marquardt, started from the answers of a network or of neighbouring frames.

    Args:
        objective: over the free controls of a `FixedControlsRig`.
        start: estimates the start; None: frames are solved from scratch and from their neighbours.
        steps: linearisations, at most.
        key_starts, descent_steps: as in `solve_frames`.
        fewer_controls: whether `with_fewer_controls` follows.
    """

    def __init__(
        self,
        objective: Objective,
        start: NetworkEstimator | None,
        steps: int,
        key_starts: int = 2,
        descent_steps: int = 60,
        fewer_controls: bool = False,
    ) -> None:
        self.objective, self.start, self.steps, self.key_starts = objective, start, steps, key_starts
        self.fewer_controls, rig = fewer_controls, objective.rig.source
        assert isinstance(rig, FixedControlsRig)
        self.rig = rig
        self.descent_steps = descent_steps if self.rig.differentiable else 0

    @property
    def space(self) -> MeshSpace:
        return self.objective.rig.space

    def units(self, controls: Tensor) -> Tensor:
        """The free ones of controls `(frame, control)`, as fractions of their ranges."""
        return self.objective.units(controls[:, self.rig.free])

    def controls(self, units: Tensor) -> Tensor:
        """All controls of free controls as fractions of their ranges, the inverse of `units`."""
        return self.rig.all_controls(self.objective.to_controls(units))

    def estimate(self, vertices: Tensor, motion: Tensor | None = None) -> Tensor:
        vertices = vertices if motion is None else remove_motion(motion, vertices)
        coordinates = self.space.encode(vertices)
        if self.start is not None:
            start = self.units(self.start.estimate(vertices))
            found = refine_meshes(self.objective, coordinates, start, self.steps)
        elif self.rig.has_first_guess:
            found = solve_from_guess(self.objective, coordinates, self._first_guess(vertices), self.steps)
        else:
            found = solve_frames(self.objective, coordinates, self.key_starts, self.steps, descent_steps=self.descent_steps)
        return self._selected(coordinates, found.units)

    def _selected(self, coordinates: Tensor, units: Tensor) -> Tensor:
        """All controls of a solution, those that a mesh does not need at neutral if that is wanted."""
        return self.controls(with_fewer_controls(self.objective, coordinates, units) if self.fewer_controls else units)

    def _first_guess(self, vertices: Tensor) -> Tensor:
        """The guess from the rig's features, as fractions of the ranges."""
        filled = torch.where(torch.isfinite(vertices), vertices, self.rig.rest_vertices)
        return first_start(self.objective, self.space.encode(filled))

    def refine(self, vertices: Tensor, controls: Tensor, motion: Tensor | None = None) -> Tensor:
        coordinates = self.space.encode(vertices if motion is None else remove_motion(motion, vertices))
        found = refine_meshes(self.objective, coordinates, self.units(controls), UPDATE_STEPS)
        return self._selected(coordinates, found.units)

    def is_exact(self, coordinates: Tensor, controls: Tensor) -> bool:
        """Whether controls `(frame, control)` that began as the rig's own guess make nearly all known meshes exactly."""
        if not self.rig.has_first_guess:
            return False
        batches = zip(self.units(controls).split(BATCH_SIZE), coordinates.split(BATCH_SIZE))
        cost = torch.cat([self.objective.cost(*batch) - self.objective.prior_cost(batch[0]) for batch in batches])
        known = cost[cost.isfinite()]
        return bool((known <= EXACT * self.objective.squared_mm).double().mean() >= MOSTLY)

    def converged(self, vertices: Tensor, controls: Tensor) -> Tensor:
        coordinates, units = self.space.encode(vertices), self.units(controls)
        cost, most = self.objective.cost(units, coordinates), 0.5 * UNCONVERGED_MM**2 * self.objective.squared_mm
        rows = (cost > most).nonzero()[:, 0]  # the others have less to gain than that
        found = torch.ones(len(vertices), dtype=torch.bool)
        if len(rows):
            more = levenberg_marquardt(self.objective, coordinates[rows], units[rows], 1)
            found[rows] = ~(cost[rows] - more.cost > most)
        return found
