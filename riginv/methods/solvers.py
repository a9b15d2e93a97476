"""Optimisation in mesh space among the methods."""

import torch
from torch import Tensor

from riginv.data.mesh_sets import MeshSet
from riginv.mesh_space import RigInMeshSpace
from riginv.methods.base import Method
from riginv.methods.network import Network
from riginv.solvers.clip import solve_clip
from riginv.solvers.every_mesh import refine_meshes, solve_frames, solve_meshes
from riginv.solvers.objective import PRIOR, Objective
from riginv.solvers.smoothing import smoothed


class LevenbergMarquardt(Method):
    """The least error of each mesh for itself; in a clip, neighbouring frames are where it starts.

    Args:
        starts: near neutral, for meshes that are no clip, and for every eighth frame of one.
        steps: linearisations from each start.
        more_steps: for frames that start from a neighbour's answer.
        descent_steps: of gradient descent, to the second start of meshes that are no clip.
        prior, sparsity: as in `Objective`.
    """

    source = (
        "riginv: Levenberg (1944), Marquardt (1963), bounded by pinning controls to their limits, in mesh coordinates with the "
        "Jacobian of the rig's own nonlinear part"
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        starts: int = 3,
        steps: int = 30,
        more_steps: int = 4,
        descent_steps: int = 150,
        prior: float = PRIOR,
        sparsity: float = 0.0,
    ) -> None:
        super().__init__(rig)
        self.starts, self.steps, self.more_steps, self.descent_steps = starts, steps, more_steps, descent_steps
        self.objective = Objective(rig, prior, sparsity)

    def invert(self, meshes: MeshSet) -> Tensor:
        coordinates = self.coordinates(meshes)
        if meshes.fps:
            found = solve_frames(self.objective, coordinates, self.starts, self.steps, self.more_steps)
        else:
            descent_steps = self.descent_steps if self.rig.rig.differentiable else 0
            found = solve_meshes(self.objective, coordinates, self.starts, self.steps, descent_steps=descent_steps)
        return self.objective.own_units(found.units)


class Clip(LevenbergMarquardt):
    """A whole clip at once, with smooth curves; meshes that are no clip are solved one by one.

    Args:
        smoothness: as in `solve_clip`.
        clip_steps: Gauss-Newton steps on the whole clip.
        blur: standard deviation of the Gaussian that smooths the frames' own answers to a start, frames.
        bundle: a trained inverse whose answers are the start in their place.
    """

    source = (
        "riginv: Gauss-Newton on all frames with squared second differences of the controls, by block-banded Cholesky in "
        "windows, from each frame's own optimum, smoothed"
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        smoothness: float = 1.5,
        clip_steps: int = 4,
        blur: float = 3.0,
        bundle: str | None = None,
        **solver: float,
    ) -> None:
        super().__init__(rig, **solver)
        self.smoothness, self.clip_steps, self.blur = smoothness, clip_steps, blur
        self.network = Network(rig, bundle) if bundle else None

    def invert(self, meshes: MeshSet) -> Tensor:
        if not meshes.fps:
            return super().invert(meshes)
        coordinates = self.coordinates(meshes)
        if self.network is not None:
            start = self.objective.units(self.network.controls(coordinates))
        else:
            start = smoothed(
                solve_frames(self.objective, coordinates, self.starts, self.steps, self.more_steps, rounds=0), self.blur
            )
        found = solve_clip(self.objective, coordinates, start, self.smoothness, self.clip_steps)
        return self.objective.own_units(found)


class Refined(Network):
    """A network's answer and a few steps of Levenberg-Marquardt from there, mesh by mesh.

    Args:
        bundle: the bundle of an inverse, or the run that holds it.
        steps: linearisations.
    """

    source = "riginv: a trained network as the start of Levenberg-Marquardt"

    def __init__(self, rig: RigInMeshSpace, bundle: str, steps: int = 5, prior: float = PRIOR) -> None:
        super().__init__(rig, bundle)
        self.steps, self.objective = steps, Objective(rig, prior)

    @torch.no_grad()
    def invert(self, meshes: MeshSet) -> Tensor:
        coordinates = self.coordinates(meshes)
        start = self.objective.units(self.controls(coordinates))
        return self.objective.own_units(refine_meshes(self.objective, coordinates, start, self.steps).units)
