"""Complete, still meshes to controls: by a network, by a solver, or by a network and then a solver."""

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from riginv.inference.inverse import Inverse
from riginv.rig.mesh_space import MeshSpace
from riginv.solvers.every_mesh import refine_meshes, solve_frames
from riginv.solvers.levenberg_marquardt import levenberg_marquardt
from riginv.solvers.objective import Objective
from riginv.tracking.constraints import ControlConstraints
from riginv.tracking.fixed_controls import FixedControlsRig

BATCH_SIZE = 512  # meshes that a network sees at a time
MORE_STEPS = 3  # of a solver, where its start is nearly there
UNSETTLED_MM = 0.02  # root mean square distance that one step more would still gain: the solver was not done


class Solving(ABC):
    """A way from complete meshes `(frame, vertex, 3)`, mm, without rigid motion, to controls `(frame, control)`."""

    @abstractmethod
    def first(self, vertices: Tensor) -> Tensor:
        """The controls of the frames of a clip."""

    @abstractmethod
    def again(self, vertices: Tensor, controls: Tensor) -> Tensor:
        """The controls, where the meshes have changed a little since `controls` were found."""

    @abstractmethod
    def settled(self, vertices: Tensor, controls: Tensor) -> Tensor:
        """Whether nothing more is to be gained, `(frame,)`."""


class ByNetwork(Solving):
    """The network alone; controls that are held, are held after it."""

    def __init__(self, inverse: Inverse, constraints: ControlConstraints) -> None:
        self.inverse, self.constraints = inverse, constraints

    @torch.no_grad()
    def first(self, vertices: Tensor) -> Tensor:
        network = self.inverse.network
        pieces = [network(network.rig.space.encode(piece)) for piece in vertices.split(BATCH_SIZE)]
        return torch.where(self.constraints.free, torch.cat(pieces), self.constraints.held)

    def again(self, vertices: Tensor, controls: Tensor) -> Tensor:
        return self.first(vertices)

    def settled(self, vertices: Tensor, controls: Tensor) -> Tensor:
        return torch.ones(len(vertices), dtype=torch.bool)


class BySolver(Solving):
    """Levenberg-Marquardt, from the answers of a network or of neighbouring frames.

    Args:
        objective: over the free controls of a `FixedControlsRig`.
        start: whose answers it starts from; None: each frame is solved from scratch, and learns from its neighbours.
        steps: linearisations, at most.
        key_starts, descent_steps: as in `solve_frames`.
    """

    def __init__(
        self, objective: Objective, start: ByNetwork | None, steps: int, key_starts: int = 2, descent_steps: int = 60
    ) -> None:
        self.objective, self.start, self.steps, self.key_starts = objective, start, steps, key_starts
        self.held: FixedControlsRig = objective.rig.rig
        self.descent_steps = descent_steps if self.held.differentiable else 0

    @property
    def space(self) -> MeshSpace:
        return self.objective.rig.space

    def units(self, controls: Tensor) -> Tensor:
        """The free ones of controls `(frame, control)` in shares of their ranges."""
        return self.objective.units(controls[:, self.held.free])

    def controls(self, units: Tensor) -> Tensor:
        """The reverse, with the held controls where they are held."""
        return self.held.all_controls(self.objective.to_controls(units))

    def first(self, vertices: Tensor) -> Tensor:
        coordinates = self.space.encode(vertices)
        if self.start is not None:
            start = self.units(self.start.first(vertices))
            found = refine_meshes(self.objective, coordinates, start, self.steps)
        else:
            found = solve_frames(self.objective, coordinates, self.key_starts, self.steps, descent_steps=self.descent_steps)
        return self.controls(found.units)

    def again(self, vertices: Tensor, controls: Tensor) -> Tensor:
        coordinates = self.space.encode(vertices)
        return self.controls(refine_meshes(self.objective, coordinates, self.units(controls), MORE_STEPS).units)

    def settled(self, vertices: Tensor, controls: Tensor) -> Tensor:
        coordinates, units = self.space.encode(vertices), self.units(controls)
        more = levenberg_marquardt(self.objective, coordinates, units, 1)
        gained = self.objective.cost(units, coordinates) - more.cost
        return ~(gained > 0.5 * UNSETTLED_MM**2 * self.objective.vertex_count)
