"""Holden et al.: Gaussian-process regression from meshes to controls."""

from torch import Tensor

from riginv.config.values import PositiveFloat, PositiveInt
from riginv.geometry.neighbours import spread_points
from riginv.methods.base import BatchedMethod
from riginv.methods.baselines.gaussian_process import GaussianProcess, PrincipalComponents, as_controls, training_poses
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.sampling.meshes import MeshSampler


class HoldenGaussianProcess(BatchedMethod):
    """One Gaussian process from the principal components of the mesh to all controls.

    Args:
        sampler: the poses that it learns from; they must come with their controls.
        drawn: poses that are drawn.
        poses: of these, how many are kept, as far apart as can be: time grows with their cube, memory with their square.
        variance: the fraction of the drawn poses' variance that the components keep.
    """

    batch_size = 1024
    source = (
        "Holden, Saito, Komura: Learning an inverse rig mapping for character animation (SCA 2015): Gaussian-process "
        "regression with a multiquadric kernel on a subsample of far-apart poses. Changed: the input is the principal "
        "components of the mesh, in mesh coordinates, where theirs is joints; a constant mean is fitted along, without "
        "which the multiquadric is no covariance; width and noise by leave-one-out error over a grid, our choice; poses "
        "are random, not an animator's; answers are clamped to the limits."
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        sampler: MeshSampler,
        drawn: PositiveInt = 10_000,
        poses: PositiveInt = 2000,
        variance: PositiveFloat = 0.999,
    ) -> None:
        super().__init__(rig)
        self.sampler, self.drawn, self.poses, self.variance = sampler, drawn, poses, variance

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        coordinates, away = training_poses(self.rig, self.sampler, self.drawn, seed)
        self.components = PrincipalComponents(coordinates, self.variance)
        inputs = self.components(coordinates)
        kept = spread_points(inputs, self.poses)
        self.process = GaussianProcess(inputs[kept], away[kept])

    def solve(self, coordinates: Tensor) -> Tensor:
        return as_controls(self.rig, self.process(self.components(coordinates)))
