"""Optimisation in mesh space among the methods."""

from typing import Any

import torch
from torch import Tensor

from riginv.config.values import NonNegativeFloat, NonNegativeInt, PositiveInt
from riginv.methods.base import Method
from riginv.methods.network import Network
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.clip import smoothed, solve_clip
from riginv.solvers.every_mesh import refine_meshes, solve_frames, solve_meshes
from riginv.solvers.fewer_controls import with_fewer_controls
from riginv.solvers.levenberg_marquardt import Solution
from riginv.solvers.objective import PRIOR, Objective


class LevenbergMarquardt(Method):
    """Levenberg-Marquardt on each mesh; in a clip, started from neighbouring frames.

    Args:
        starts: number of starts of each unrelated mesh.
        key_starts: of every fourth frame of a clip.
        steps: linearisations from each start.
        more_steps: for frames that start from a neighbour's answer.
        descent_steps: of gradient descent, to the second start.
        prior, sparsity: as in `Objective`.
        fewer_controls: whether `with_fewer_controls` follows; in `Clip` before the curves are smoothed.
    """

    source = (
        "riginv: Levenberg (1944), Marquardt (1963), bounded by pinning controls to their limits, in mesh coordinates with the "
        "Jacobian of the rig's own nonlinear part"
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        starts: PositiveInt = 3,
        key_starts: PositiveInt = 2,
        steps: PositiveInt = 30,
        more_steps: NonNegativeInt = 3,
        descent_steps: NonNegativeInt = 60,
        prior: NonNegativeFloat = PRIOR,
        sparsity: NonNegativeFloat = 0.0,
        fewer_controls: bool = False,
    ) -> None:
        super().__init__(rig)
        self.starts, self.key_starts, self.steps, self.more_steps = starts, key_starts, steps, more_steps
        self.descent_steps = descent_steps if rig.source.differentiable else 0
        self.objective, self.fewer_controls = Objective(rig, prior, sparsity), fewer_controls

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        _ = self.objective.features  # fitted now, not within the first set

    def invert(self, meshes: MeshSet) -> Tensor:
        coordinates = self.coordinates(meshes)
        if meshes.fps:
            found = self.frames(coordinates)
        else:
            found = solve_meshes(self.objective, coordinates, self.starts, self.steps, descent_steps=self.descent_steps)
        units = with_fewer_controls(self.objective, coordinates, found.units) if self.fewer_controls else found.units
        return self.objective.to_controls(units)

    def frames(self, coordinates: Tensor, rounds: int = 3) -> Solution:
        """The frames of a clip, each for itself; `rounds` as in `solve_frames`."""
        return solve_frames(
            self.objective, coordinates, self.key_starts, self.steps, self.more_steps, rounds, self.descent_steps
        )


class Clip(LevenbergMarquardt):
    """A whole clip at once, with smooth curves; unrelated meshes are solved one by one.

    Args:
        smoothness, full_smoothness_mm: as in `solve_clip`.
        clip_steps: Gauss-Newton steps on the whole clip.
        mean_steps: as many after these, in which every vertex counts by its distance and not by the square.
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
        smoothness: NonNegativeFloat = 1.5,
        clip_steps: PositiveInt = 4,
        blur: NonNegativeFloat = 3.0,
        mean_steps: NonNegativeInt = 0,
        bundle: str | None = None,
        full_smoothness_mm: NonNegativeFloat = 0.02,
        **solver: Any,
    ) -> None:
        super().__init__(rig, **solver)
        self.smoothness, self.clip_steps, self.blur, self.mean_steps = smoothness, clip_steps, blur, mean_steps
        self.full_smoothness_mm = full_smoothness_mm
        self.network = Network(rig, bundle) if bundle else None
        if self.network:
            self.trained_seconds, self.fingerprint = self.network.trained_seconds, self.network.fingerprint

    def invert(self, meshes: MeshSet) -> Tensor:
        if not meshes.fps:
            return super().invert(meshes)
        coordinates = self.coordinates(meshes)
        start, own = self._start(meshes, coordinates)
        found = solve_clip(
            self.objective,
            coordinates,
            start,
            self.smoothness,
            self.clip_steps,
            self.mean_steps,
            numbers=meshes.frame_numbers,
            full_smoothness_mm=self.full_smoothness_mm,
            own=own,
        )
        return self.objective.to_controls(found)

    def _start(self, meshes: MeshSet, coordinates: Tensor) -> tuple[Tensor, Tensor]:
        """The curves to start from, the frames' own solutions, smoothed, or a network's; and these before they are smoothed."""
        if self.network is None:
            found = self.frames(coordinates, rounds=0)
        else:
            found = Solution.at_neutral(self.objective, len(coordinates))
            found.units = self.objective.units(self.network.invert(meshes))
            if not self.fewer_controls:
                return found.units, found.units
            found.skipped = ~torch.isfinite(coordinates).all(dim=1)
        if self.fewer_controls:
            found.units = with_fewer_controls(self.objective, coordinates, found.units)
        return smoothed(found, self.blur, meshes.frame_numbers), found.units


class Refined(Network):
    """The output of a network, and a few steps of Levenberg-Marquardt from there, mesh by mesh.

    Args:
        bundle: the bundle of an inverse, or the run that holds it.
        steps: linearisations.
        fewer_controls: whether `with_fewer_controls` follows.
    """

    source = "riginv: a trained network as the start of Levenberg-Marquardt"

    def __init__(
        self,
        rig: RigInMeshSpace,
        bundle: str,
        steps: PositiveInt = 5,
        prior: NonNegativeFloat = PRIOR,
        fewer_controls: bool = False,
    ) -> None:
        super().__init__(rig, bundle)
        self.steps, self.objective, self.fewer_controls = steps, Objective(rig, prior), fewer_controls

    @torch.no_grad()
    def invert(self, meshes: MeshSet) -> Tensor:
        start, coordinates = self.objective.units(super().invert(meshes)), self.coordinates(meshes)
        found = refine_meshes(self.objective, coordinates, start, self.steps).units
        if self.fewer_controls:
            found = with_fewer_controls(self.objective, coordinates, found)
        return self.objective.to_controls(found)
