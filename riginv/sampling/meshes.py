"""Samplers of meshes, in mesh coordinates."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor, nn

from riginv.config.building import class_of
from riginv.config.values import NonNegativeFloat, PositiveInt
from riginv.errors import InputError
from riginv.rig.batches import PoseBatch
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import (
    ControlSampler,
    check_plausible,
    choose,
    faint_strength,
    log_uniform_counts,
    uniform_counts,
)


class MeshSampler(nn.Module, ABC):
    """Draws meshes, in mesh coordinates."""

    @classmethod
    def belongs_to(cls, rig: LinearRig) -> bool:
        """Whether a mixture for this rig should hold it (`riginv.sampling.meshes`)."""
        return True

    @abstractmethod
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        """A batch of `count` meshes, without gradients."""

    def sample_rows(self, count: int, generator: torch.Generator, rows: slice) -> PoseBatch:
        """Some rows of the batch that `sample` gives: what one of several processes takes of it."""
        return PoseBatch({key: values[rows] for key, values in self.sample(count, generator).items()})

    def sample_controls(self, count: int, generator: torch.Generator) -> Tensor:
        """Controls `(count, control)` alone, for who poses the rig elsewhere.

        Raises:
            InputError: it draws meshes that are no poses of the rig.
        """
        raise InputError(
            f"{type(self).__name__} draws meshes that no controls make: choose a sampler of poses, such as sampler=rig_poses"
        )

    def reading(self, stored: "MeshSampler") -> "MeshSampler":
        """The same sampler, with poses that are stored in place of those that it would ask the rig for."""
        return self

    def at_step(self, step: int) -> None:
        """Training has come to a step; what reads stored poses in order goes to its place."""


class RigPoses(MeshSampler):
    """Poses of the rig, with the controls that made them."""

    def __init__(self, rig: RigInMeshSpace, controls: ControlSampler) -> None:
        super().__init__()
        self.rig, self.controls = rig, controls

    def sample_controls(self, count: int, generator: torch.Generator) -> Tensor:
        return self.controls.sample(count, generator)

    def reading(self, stored: MeshSampler) -> MeshSampler:
        return stored

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        controls = self.controls.sample(count, generator)
        coefficients = self.rig.rig.coefficients(controls)
        return PoseBatch(coordinates=self.rig.coordinates_of(coefficients), controls=controls, coefficients=coefficients)


class OfBlendshapes(MeshSampler):
    """Draws from a rig's blendshapes, which it must have."""

    @classmethod
    def belongs_to(cls, rig: LinearRig) -> bool:
        return rig.has_blendshapes


class RandomCombinations(OfBlendshapes):
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
        return PoseBatch(coordinates=random_weights(len(self.rig.linear_map), count, generator) @ self.rig.linear_map)


def random_weights(shapes: int, count: int, generator: torch.Generator) -> Tensor:
    """Weights `(count, shape)` in [0, 1]: how many shapes take part is uniform, and so are their weights."""
    active = choose(uniform_counts(count, shapes, generator), shapes, generator)
    return torch.where(active, torch.rand(count, shapes, generator=generator, device=generator.device), 0.0)


class PlausibleCombinations(OfBlendshapes):
    """A few primary shapes at a time added linearly, as captured faces are: near the rig's poses, mostly not among them.

    Args:
        most: the greatest number of shapes at once; the number is log-uniform.
        faint: the share of meshes that are scaled down as a whole.

    Raises:
        InputError: the rig has no blendshapes, or a number is out of range.
    """

    def __init__(self, rig: RigInMeshSpace, most: PositiveInt = 60, faint: NonNegativeFloat = 0.5) -> None:
        super().__init__()
        check_plausible(most, faint)
        _need_blendshapes(rig)
        self.rig, self.faint = rig, faint
        self.shapes = rig.rig.primary_count
        self.most = min(most, self.shapes)

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        active = choose(log_uniform_counts(count, self.most, generator), self.shapes, generator)
        values = torch.rand(count, self.shapes, generator=generator, device=generator.device)
        weights = torch.where(active, values, 0.0) * faint_strength(count, self.faint, generator)
        return PoseBatch(coordinates=weights @ self.rig.linear_map[: self.shapes])


class Mixture(MeshSampler):
    """Several samplers, each making its share of every batch.

    Args:
        samplers: by name.
        shares: of each, by the same names; they need not add up to 1.

    Raises:
        InputError: the names differ, or a share is negative, or all are zero.
    """

    def __init__(self, rig: RigInMeshSpace | None, samplers: Mapping[str, MeshSampler], shares: Mapping[str, float]) -> None:
        super().__init__()
        if set(samplers) != set(shares):
            raise InputError(f"sampler.shares names {sorted(shares)}, expected {sorted(samplers)} as in sampler.samplers")
        for name, share in shares.items():
            if not share >= 0:
                raise InputError(f"sampler.shares.{name} is {share}, expected at least 0")
        total = sum(shares.values())
        if not total > 0:
            raise InputError("sampler.shares are all 0: at least one must be above 0")
        self.samplers = nn.ModuleDict(samplers)
        self.shares = {name: shares[name] / total for name in samplers}

    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        parts = [sampler.sample(size, generator) for sampler, size in self._sizes(count)]
        common = set.intersection(*(set(part) for part in parts))  # controls only where every part knows them
        return PoseBatch({key: torch.cat([part[key] for part in parts]) for key in sorted(common)})

    def sample_controls(self, count: int, generator: torch.Generator) -> Tensor:
        return torch.cat([sampler.sample_controls(size, generator) for sampler, size in self._sizes(count)])

    def reading(self, stored: MeshSampler) -> MeshSampler:
        samplers, shares = {}, {}
        for name, sampler in self.samplers.items():
            found = sampler.reading(stored)
            kept = "stored" if found is stored else name
            samplers[kept], shares[kept] = found, shares.get(kept, 0.0) + self.shares[name]
        return Mixture(None, samplers, shares)

    def at_step(self, step: int) -> None:
        for sampler in self.samplers.values():
            sampler.at_step(step)

    def _sizes(self, count: int) -> list[tuple[MeshSampler, int]]:
        """How many of a batch each sampler makes, those left out that make none."""
        ends = torch.tensor(list(self.shares.values())).cumsum(0).mul(count).round().long().tolist()
        sizes = zip(self.samplers.values(), [0, *ends], ends)
        return [(sampler, end - start) for sampler, start, end in sizes if end > start]


class WithNoise(MeshSampler):
    """A sampler whose meshes are disturbed as captured ones are; the controls, where there are any, stay those of the pose."""

    def __init__(self, sampler: MeshSampler, noise: nn.Module) -> None:
        super().__init__()
        self.sampler, self.noise = sampler, noise

    def at_step(self, step: int) -> None:
        self.sampler.at_step(step)

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        batch = self.sampler.sample(count, generator)
        return PoseBatch({**batch, "coordinates": batch["coordinates"] + self.noise.sample(count, generator)})


class StoredPoses(MeshSampler):
    """A fixed set of poses from which batches are picked at random, as from a data set on disk.

    Args:
        poses: all of them.

    Raises:
        InputError: there are none.
    """

    BATCH_SIZE = 500

    def __init__(self, poses: PoseBatch) -> None:
        super().__init__()
        if not len(poses["coordinates"]):
            raise InputError("there are no stored poses to train on: data.stored_poses must be at least 1")
        for key, values in poses.items():
            self.register_buffer(key, values, persistent=False)
        self.keys = list(poses)

    @classmethod
    def drawn(cls, sampler: MeshSampler, count: int, generator: torch.Generator) -> "StoredPoses":
        """`count` samples of a sampler, drawn once.

        Args:
            generator: what they are drawn with.
        """
        starts = track(range(0, count, cls.BATCH_SIZE), "posing the rig", console=Console(stderr=True), transient=True)
        pieces = [sampler.sample(min(cls.BATCH_SIZE, count - start), generator) for start in starts]
        return cls(PoseBatch({key: torch.cat([piece[key] for piece in pieces]) for key in pieces[0]} if pieces else {}))

    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        return self.sample_rows(count, generator, slice(None))

    def sample_rows(self, count: int, generator: torch.Generator, rows: slice) -> PoseBatch:
        picked = torch.randint(len(self.coordinates), (count,), generator=generator, device=generator.device)[rows]
        return PoseBatch({key: self.get_buffer(key)[picked] for key in self.keys})


def _need_blendshapes(rig: RigInMeshSpace) -> None:
    if not rig.rig.has_blendshapes:
        raise InputError(f"rig '{rig.rig.name}' has no blendshapes to combine: choose sampler=rig_poses")


Config = dict[str, Any]


def fitted(config: Config, rig: LinearRig) -> Config:
    """The config of a sampler, less those parts of a mixture whose classes do not belong to the rig.

    Random combinations need blendshapes; poses whose joints move together are for rigs without. A sampler that is not a
    mixture stays as it is: what does not suit the rig then says so.

    Raises:
        InputError: a part names a class that does not exist.
    """
    if "samplers" not in config:
        return config
    parts = {name: part for name, part in config["samplers"].items() if _belongs(part, rig, MeshSampler)}
    shares = {name: share for name, share in config["shares"].items() if name in parts or name not in config["samplers"]}
    return {**config, "samplers": parts, "shares": shares}


def _belongs(part: Config, rig: LinearRig, kind: type[MeshSampler | ControlSampler]) -> bool:
    inner = part.get("controls")
    belongs = class_of(part.get("_target_"), kind=kind).belongs_to(rig)
    return belongs and (inner is None or _belongs(inner, rig, ControlSampler))
