"""Meshes near the poses of a rig, but not among them, for rigs without blendshapes."""

import math

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.mesh_space import RigInMeshSpace
from riginv.rig import LinearRig
from riginv.sampling.controls import ControlSampler
from riginv.sampling.meshes import MeshSampler, PoseBatch

FAINTEST = 0.1  # of the strongest disturbance


class DisturbedPoses(MeshSampler):
    """Poses to which is added what a small change of the controls does in another pose.

    There the change is the rig's own; here it is a smooth disturbance that no controls make, as captured and retargeted
    bodies hold it. A network that has only seen exact poses takes every such remainder for something to be corrected.

    Args:
        controls: what draws the poses.
        strength: the greatest standard deviation of the change, as a share of each control's range; it is log-uniform
            from a tenth of that.

    Raises:
        InputError: the strength is out of range.
    """

    def __init__(self, rig: RigInMeshSpace, controls: ControlSampler, strength: float = 0.005) -> None:
        super().__init__()
        if not 0 < strength <= 1:
            raise InputError(f"sampler: strength is {strength}, expected a share above 0, up to 1")
        self.rig, self.controls, self.strength = rig, controls, strength

    @classmethod
    def belongs_to(cls, rig: LinearRig) -> bool:
        return not rig.has_blendshapes and rig.differentiable  # a black box would be asked three times as often

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        here, there = self.controls.sample(count, generator), self.controls.sample(count, generator)
        changed = self._changed(there, generator)
        poses = self.rig(torch.cat([here, there, changed]))
        here, there, changed = poses.chunk(3)
        return PoseBatch(coordinates=here + changed - there)

    def _changed(self, controls: Tensor, generator: torch.Generator) -> Tensor:
        lower, upper = self.controls.lower, self.controls.upper
        draws = torch.rand(len(controls), 1, generator=generator, device=generator.device).to(controls)
        strength = self.strength * (math.log(FAINTEST) * draws).exp()
        change = torch.randn(controls.shape, generator=generator, device=generator.device).to(controls)
        return torch.minimum(torch.maximum(controls + strength * change * (upper - lower), lower), upper)
