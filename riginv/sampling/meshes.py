"""Samplers of meshes, in mesh coordinates."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TypedDict

import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.mesh_space import RigInMeshSpace
from riginv.rig import BlendshapeRig
from riginv.sampling.controls import (
    ControlSampler,
    check_plausible,
    choose,
    faint_strength,
    log_uniform_counts,
    uniform_counts,
)


class PoseBatch(TypedDict, total=False):
    """A batch to train on.

    Attributes:
        coordinates: mesh coordinates `(batch, coordinate)`.
        controls: the controls that made them, `(batch, control)`; only where the meshes are poses of the rig.
    """

    coordinates: Tensor
    controls: Tensor


class MeshSampler(nn.Module, ABC):
    """Draws meshes, in mesh coordinates."""

    @abstractmethod
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        """A batch of `count` meshes, without gradients."""


class RigPoses(MeshSampler):
    """Poses of the rig, with the controls that made them."""

    def __init__(self, rig: RigInMeshSpace, controls: ControlSampler) -> None:
        super().__init__()
        self.rig, self.controls = rig, controls

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        controls = self.controls.sample(count, generator)
        return PoseBatch(coordinates=self.rig(controls), controls=controls)


class RandomCombinations(MeshSampler):
    """The paper's meshes for the inverse: blendshapes combined with no regard for the rig's logic, count and values uniform.

    Raises:
        InputError: the rig has no blendshapes.
    """

    def __init__(self, rig: RigInMeshSpace) -> None:
        super().__init__()
        _need_blendshapes(rig)
        self.rig = rig

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        return PoseBatch(coordinates=self.weights(count, generator) @ self.rig.linear_map)

    def weights(self, count: int, generator: torch.Generator) -> Tensor:
        """Weights of the blendshapes, `(count, shape)` in [0, 1]."""
        shapes = len(self.rig.linear_map)
        active = choose(uniform_counts(count, shapes, generator), shapes, generator)
        values = torch.rand(count, shapes, generator=generator, device=generator.device)
        return torch.where(active, values, 0.0)


class PlausibleCombinations(MeshSampler):
    """A few primary shapes at a time added linearly, as captured faces are: near the rig's poses, mostly not among them.

    Args:
        most: the greatest number of shapes at once; the number is log-uniform.
        faint: the share of meshes that are scaled down as a whole.

    Raises:
        InputError: the rig has no blendshapes, or a number is out of range.
    """

    def __init__(self, rig: RigInMeshSpace, most: int = 60, faint: float = 0.5) -> None:
        super().__init__()
        check_plausible(most, faint)
        self.rig, self.faint = rig, faint
        self.shapes = _need_blendshapes(rig).primary_count
        self.most = min(most, self.shapes)

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        active = choose(log_uniform_counts(count, self.most, generator), self.shapes, generator)
        values = torch.rand(count, self.shapes, generator=generator, device=generator.device)
        weights = torch.where(active, values, 0.0) * faint_strength(count, self.faint, generator)
        return PoseBatch(coordinates=weights @ self.rig.linear_map[: self.shapes])


class Mixture(MeshSampler):
    """Several samplers, each making its share of every batch.

    Raises:
        InputError: the shares do not fit the samplers, or one is negative, or all are zero.
    """

    def __init__(self, samplers: Sequence[MeshSampler], shares: Sequence[float]) -> None:
        super().__init__()
        if len(samplers) != len(shares) or min(shares, default=0) < 0 or sum(shares) <= 0:
            raise InputError(f"sampler: the shares {list(shares)} must be {len(samplers)} numbers of at least 0, not all 0")
        self.samplers = nn.ModuleList(samplers)
        self.shares = [share / sum(shares) for share in shares]

    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        ends = torch.tensor(self.shares).cumsum(0).mul(count).round().long().tolist()
        counts = [end - start for start, end in zip([0, *ends], ends)]
        parts = [sampler.sample(part, generator) for sampler, part in zip(self.samplers, counts) if part]
        return PoseBatch(coordinates=torch.cat([part["coordinates"] for part in parts]))


class WithNoise(MeshSampler):
    """A sampler whose meshes are disturbed as captured ones are; the controls, where there are any, stay those of the pose."""

    def __init__(self, sampler: MeshSampler, noise: nn.Module) -> None:
        super().__init__()
        self.sampler, self.noise = sampler, noise

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        batch = self.sampler.sample(count, generator)
        return PoseBatch({**batch, "coordinates": batch["coordinates"] + self.noise.sample(count, generator)})


def _need_blendshapes(rig: RigInMeshSpace) -> BlendshapeRig:
    if not isinstance(rig.rig, BlendshapeRig):
        raise InputError(f"rig '{rig.rig.name}' has no blendshapes to combine: choose sampler=rig_poses")
    return rig.rig
