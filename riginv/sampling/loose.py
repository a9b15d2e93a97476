"""Meshes near the poses of a jointed rig, but not among them."""

import math

import torch
from torch import Tensor

from riginv.config.values import PositiveFloat
from riginv.errors import InputError
from riginv.rig.batches import PoseBatch
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import ControlSampler, choose, log_uniform_counts
from riginv.sampling.meshes import MeshSampler

FAINTEST = 0.1  # of the strongest


class LoosePoses(MeshSampler):
    """Poses of the rig in which joints also turn as no control turns them (`LinearRig.loose_coefficients`).

    Captured and retargeted bodies hold such turns: a wrist that twists without its forearm, a knee that gives sideways. A
    network that has only seen exact poses takes every one of them for a change of some control.

    Args:
        controls: what draws the poses.
        strength: how far the parts go at most, as a share of what the rig says of each; it is log-uniform from a tenth of that.

    Raises:
        InputError: the rig has no loose parts, or the strength is not above 0.
    """

    def __init__(self, rig: RigInMeshSpace, controls: ControlSampler, strength: PositiveFloat = 1.0) -> None:
        super().__init__()
        if not strength > 0:
            raise InputError(f"sampler: strength is {strength}, expected a number above 0")
        if not self.belongs_to(rig.rig):
            raise InputError(f"rig '{rig.rig.name}' has no loose parts: choose sampler=rig_poses")
        self.rig, self.controls, self.strength = rig, controls, strength

    @classmethod
    def belongs_to(cls, rig: LinearRig) -> bool:
        return len(rig.loose_parts) > 0

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        controls = self.controls.sample(count, generator)
        parts = loose_parts(self.rig.rig, count, generator, self.strength)
        coefficients = self.rig.rig.loose_coefficients(controls, parts)
        return PoseBatch(coordinates=self.rig.coordinates_of(coefficients))


def loose_parts(rig: LinearRig, count: int, generator: torch.Generator, strength: float = 1.0) -> Tensor:
    """How far parts move on their own, `(count, part)`: their number is log-uniform, and so is their strength as a whole."""
    size, device = len(rig.loose_parts), generator.device
    active = choose(log_uniform_counts(count, size, generator), size, generator)
    faintness = (math.log(FAINTEST) * torch.rand(count, 1, generator=generator, device=device)).exp()
    draws = torch.randn(count, size, generator=generator, device=device).to(rig.loose_parts)
    return torch.where(active, strength * faintness.to(draws) * draws * rig.loose_parts, 0.0)
