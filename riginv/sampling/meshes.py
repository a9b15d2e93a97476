"""Samplers of meshes, in mesh coordinates."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, cast

import torch
from jaxtyping import Float
from rich.console import Console
from rich.progress import track
from torch import Tensor, nn

from riginv.config.building import class_of
from riginv.config.values import Fraction, PositiveInt
from riginv.errors import InputError
from riginv.geometry.products import matmul
from riginv.rig.batches import PoseBatch, known_controls, map_batches
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import choose, log_uniform_counts, uniform_counts
from riginv.sampling.controls import ControlSampler, check_plausible, random_strength
from riginv.sampling.noise import CaptureNoise


class MeshSampler(nn.Module, ABC):
    """Draws random meshes, in mesh coordinates."""

    @classmethod
    def suits(cls, rig: LinearRig) -> bool:
        """Whether a mixture for this rig includes this sampler (`select_for_rig`)."""
        return True

    @abstractmethod
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        """A batch of `count` meshes, without gradients."""

    def sample_rows(self, count: int, generator: torch.Generator, rows: slice) -> PoseBatch:
        """Some rows of the batch of `sample`: the part of one of several processes."""
        return map_batches(lambda values: values[rows], self.sample(count, generator))

    def sample_controls(self, count: int, generator: torch.Generator) -> Float[Tensor, "count control"]:
        """Controls `(count, control)` alone, to pose the rig elsewhere.

        Raises:
            InputError: the sampler draws meshes that are not poses of the rig.
        """
        raise InputError(
            f"{type(self).__name__} draws meshes that no controls make: choose a sampler of poses, such as sampler=rig_poses"
        )

    def reading(self, stored: "MeshSampler") -> "MeshSampler":
        """This sampler with stored poses in place of those that it would pose the rig for."""
        return self

    def at_step(self, step: int) -> None:
        """Move to a training step; samplers that read stored poses in order override it."""


class RigPoses(MeshSampler):
    """Poses of the rig, with their controls and coefficients."""

    def __init__(self, rig: RigInMeshSpace, controls: ControlSampler) -> None:
        super().__init__()
        self.rig, self.controls = rig, controls

    def sample_controls(self, count: int, generator: torch.Generator) -> Float[Tensor, "count control"]:
        return self.controls.sample(count, generator)

    def reading(self, stored: MeshSampler) -> MeshSampler:
        return stored

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        controls = self.controls.sample(count, generator)
        coefficients = self.rig.source.coefficients(controls)
        return PoseBatch(coordinates=self.rig.coordinates_of(coefficients), controls=controls, coefficients=coefficients)


class BlendshapeSampler(MeshSampler):
    """A sampler for rigs with blendshapes.

    Raises:
        InputError: the rig has none.
    """

    def __init__(self, rig: RigInMeshSpace) -> None:
        super().__init__()
        if not rig.source.has_blendshapes:
            raise InputError(f"rig '{rig.source.name}' has no blendshapes to combine: choose sampler=rig_poses")
        self.rig = rig

    @classmethod
    def suits(cls, rig: LinearRig) -> bool:
        return rig.has_blendshapes


class RandomCombinations(BlendshapeSampler):
    """The paper's meshes for the inverse: combinations of any blendshapes, whose number and weights are uniform."""

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        return PoseBatch(coordinates=matmul(random_weights(len(self.rig.linear_map), count, generator), self.rig.linear_map))


def random_weights(shapes: int, count: int, generator: torch.Generator) -> Float[Tensor, "count shape"]:
    """Weights `(count, shape)` in [0, 1]: the number of active shapes is uniform, and so are their weights."""
    active = choose(uniform_counts(count, shapes, generator), shapes, generator)
    return torch.where(active, torch.rand(count, shapes, generator=generator, device=generator.device), 0.0)


class PlausibleCombinations(BlendshapeSampler):
    """Linear combinations of a few primary shapes: near the rig's poses, mostly not among them, like captured faces.

    Args:
        max_active: the greatest number of active shapes; the number is log-uniform.
        weak_fraction: the fraction of meshes that are scaled towards neutral.

    Raises:
        InputError: the rig has no blendshapes, or a number is out of range.
    """

    def __init__(self, rig: RigInMeshSpace, max_active: PositiveInt = 60, weak_fraction: Fraction = 0.5) -> None:
        super().__init__(rig)
        check_plausible(max_active, weak_fraction)
        self.weak_fraction = weak_fraction
        self.shapes = rig.source.primary_count
        self.max_active = min(max_active, self.shapes)

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        active = choose(log_uniform_counts(count, self.max_active, generator), self.shapes, generator)
        values = torch.rand(count, self.shapes, generator=generator, device=generator.device)
        weights = torch.where(active, values, 0.0) * random_strength(count, self.weak_fraction, generator)
        return PoseBatch(coordinates=matmul(weights, self.rig.linear_map[: self.shapes]))


class Mixture(MeshSampler):
    """Several samplers, each of which draws a fraction of every batch.

    Args:
        samplers: by name.
        fractions: of each, by the same names; they need not add up to 1.

    Raises:
        InputError: the names differ, or a fraction is negative, or all are zero.
    """

    def __init__(self, rig: RigInMeshSpace | None, samplers: Mapping[str, MeshSampler], fractions: Mapping[str, float]) -> None:
        super().__init__()
        if set(samplers) != set(fractions):
            raise InputError(f"sampler.fractions names {sorted(fractions)}, expected {sorted(samplers)} as in sampler.samplers")
        for name, fraction in fractions.items():
            if not fraction >= 0:
                raise InputError(f"sampler.fractions.{name} is {fraction}, expected at least 0")
        total = sum(fractions.values())
        if not total > 0:
            raise InputError("sampler.fractions are all 0: at least one must be above 0")
        self.samplers = nn.ModuleDict(samplers)
        self.fractions = {name: fractions[name] / total for name in samplers}

    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        parts = [sampler.sample(size, generator) for sampler, size in self._sizes(count)]
        known = [known_controls(part) for part in parts]
        batch = map_batches(lambda *values: torch.cat(values), *parts)
        if "controls" not in batch and (some := [controls for controls in known if controls is not None]):
            unknown = some[0].new_full((count, some[0].shape[1]), torch.nan)
            sizes = [len(part["coordinates"]) for part in parts]
            pairs = zip(known, unknown.split(sizes))
            batch["known_controls"] = torch.cat([rows if controls is None else controls for controls, rows in pairs])
        return batch

    def sample_controls(self, count: int, generator: torch.Generator) -> Float[Tensor, "count control"]:
        return torch.cat([sampler.sample_controls(size, generator) for sampler, size in self._sizes(count)])

    def reading(self, stored: MeshSampler) -> MeshSampler:
        samplers: dict[str, MeshSampler] = {}
        fractions: dict[str, float] = {}
        for name, sampler in self._parts().items():
            found = sampler.reading(stored)
            key = "stored" if found is stored else name
            samplers[key], fractions[key] = found, fractions.get(key, 0.0) + self.fractions[name]
        return Mixture(None, samplers, fractions)

    def at_step(self, step: int) -> None:
        for sampler in self._parts().values():
            sampler.at_step(step)

    def _parts(self) -> dict[str, MeshSampler]:
        return cast(dict[str, MeshSampler], dict(self.samplers.items()))  # nn.ModuleDict has no type of its values

    def _sizes(self, count: int) -> list[tuple[MeshSampler, int]]:
        """The samplers that draw some of a batch, and how many meshes each."""
        ends = torch.tensor(list(self.fractions.values())).cumsum(0).mul(count).round().long().tolist()
        sizes = zip(self._parts().values(), [0, *ends], ends)
        return [(sampler, end - start) for sampler, start, end in sizes if end > start]


class WithNoise(MeshSampler):
    """A sampler whose meshes have capture noise; controls, where there are any, stay those of the pose."""

    def __init__(self, sampler: MeshSampler, noise: CaptureNoise) -> None:
        super().__init__()
        self.sampler, self.noise = sampler, noise

    def at_step(self, step: int) -> None:
        self.sampler.at_step(step)

    @torch.no_grad()
    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        batch = self.sampler.sample(count, generator)
        batch["coordinates"] = batch["coordinates"] + self.noise.sample(count, generator)
        return batch


class StoredPoses(MeshSampler):
    """A fixed set of poses from which batches are drawn at random, like a data set on disk.

    Raises:
        InputError: there are no poses.
    """

    BATCH_SIZE = 500
    coordinates: Tensor

    def __init__(self, poses: PoseBatch) -> None:
        super().__init__()
        if "coordinates" not in poses or not len(poses["coordinates"]):
            raise InputError("there are no stored poses to train on: data.stored_poses must be at least 1")
        self.keys = list(poses)
        for key in self.keys:
            self.register_buffer(key, cast(dict, poses)[key], persistent=False)

    @classmethod
    def drawn(cls, sampler: MeshSampler, count: int, generator: torch.Generator) -> "StoredPoses":
        """`count` samples of a sampler, drawn once."""
        starts = track(range(0, count, cls.BATCH_SIZE), "posing the rig", console=Console(stderr=True), transient=True)
        batches = [sampler.sample(min(cls.BATCH_SIZE, count - start), generator) for start in starts]
        return cls(map_batches(lambda *values: torch.cat(values), *batches) if batches else PoseBatch())

    def sample(self, count: int, generator: torch.Generator) -> PoseBatch:
        return self.sample_rows(count, generator, slice(None))

    def sample_rows(self, count: int, generator: torch.Generator, rows: slice) -> PoseBatch:
        drawn = torch.randint(len(self.coordinates), (count,), generator=generator, device=generator.device)[rows]
        return cast(PoseBatch, {key: self.get_buffer(key)[drawn] for key in self.keys})


Config = dict[str, Any]


def select_for_rig(config: Config, rig: LinearRig) -> Config:
    """The config of a sampler, without the parts of a mixture that do not apply to the rig.

    Random combinations need blendshapes; correlated poses are for rigs without. A sampler that is not a mixture is returned
    unchanged, and its constructor refuses a rig that it cannot take.

    Raises:
        InputError: a part names a class that does not exist.
    """
    samplers, given = config.get("samplers"), config.get("fractions", {})
    if samplers is None:
        return config
    parts = {name: part for name, part in samplers.items() if _belongs(part, rig, MeshSampler)}
    fractions = {name: fraction for name, fraction in given.items() if name in parts or name not in samplers}
    return {**config, "samplers": parts, "fractions": fractions}


def _belongs(part: Config, rig: LinearRig, kind: type[MeshSampler | ControlSampler]) -> bool:
    inner = part.get("controls")
    found: Any = class_of(part.get("_target_"), kind=kind)
    return found.suits(rig) and (inner is None or _belongs(inner, rig, ControlSampler))
