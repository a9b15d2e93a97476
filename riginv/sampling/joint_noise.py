"""Meshes near the poses of a skinned rig: joints have rotations that no control produces."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.config.values import PositiveFloat
from riginv.errors import InputError
from riginv.rig.batches import PoseBatch
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import choose, log_uniform_counts
from riginv.sampling.controls import ControlSampler
from riginv.sampling.meshes import MeshSampler

WEAKEST = 0.1  # of the strongest


class JointNoisePoses(MeshSampler):
    """Poses of the rig with random rotations of joints that no control makes (`LinearRig.coefficients_with_joint_noise`).

    Captured and retargeted bodies have such rotations: a wrist that twists without its forearm, a knee that bends sideways. A
    network trained on exact poses attributes each of them to some control.

    Args:
        controls: the sampler of the poses.
        strength: the greatest standard deviation, as a multiple of the rig's; each mesh draws its own, log-uniform from a tenth
            of it.

    Raises:
        InputError: the rig has no joint noise, or the strength is not above 0.
    """

    def __init__(self, rig: RigInMeshSpace, controls: ControlSampler, strength: PositiveFloat = 1.0) -> None:
        super().__init__()
        if not strength > 0:
            raise InputError(f"sampler: strength is {strength}, expected a number above 0")
        if not self.suits(rig.source):
            raise InputError(f"rig '{rig.source.name}' has no joint noise: choose sampler=rig_poses")
        self.rig, self.controls, self.strength = rig, controls, strength

    @classmethod
    def suits(cls, rig: LinearRig) -> bool:
        return len(rig.joint_noise) > 0

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        controls = self.controls.sample(count, generator)
        parts = random_joint_noise(self.rig.source, count, generator, self.strength)
        coefficients = self.rig.source.coefficients_with_joint_noise(controls, parts)
        return PoseBatch(coordinates=self.rig.coordinates_of(coefficients))


def random_joint_noise(
    rig: LinearRig, count: int, generator: torch.Generator, strength: float = 1.0
) -> Float[Tensor, "count part"]:
    """Random joint noise `(count, part)`: the number of active parts is log-uniform, and so is the strength of each mesh."""
    size, device = len(rig.joint_noise), generator.device
    active = choose(log_uniform_counts(count, size, generator), size, generator)
    weakness = (math.log(WEAKEST) * torch.rand(count, 1, generator=generator, device=device)).exp()
    draws = torch.randn(count, size, generator=generator, device=device).to(rig.joint_noise)
    return torch.where(active, strength * weakness.to(draws) * draws * rig.joint_noise, 0.0)
