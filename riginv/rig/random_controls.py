"""Samplers of controls."""

import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace


class ControlSampler(nn.Module, ABC):
    """Draws random controls `(count, control)` within the limits of a rig."""

    lower: Tensor
    upper: Tensor
    neutral: Tensor

    def __init__(self, rig: RigInMeshSpace) -> None:
        super().__init__()
        self.register_buffer("lower", rig.rig.lower, persistent=False)
        self.register_buffer("upper", rig.rig.upper, persistent=False)
        self.register_buffer("neutral", rig.rig.neutral_controls, persistent=False)

    @classmethod
    def belongs_to(cls, rig: LinearRig) -> bool:
        """Whether a mixture for this rig includes this sampler (`riginv.sampling.meshes.select_for_rig`)."""
        return True

    @abstractmethod
    def sample(self, count: int, generator: torch.Generator) -> Tensor:
        """Controls `(count, control)`."""


class SparseControls(ControlSampler):
    """The paper's: the number of active controls and their values are uniform (paper, "Differentiable rig function").

    Args:
        most: the greatest number of controls that leave neutral; None: all of them.

    Raises:
        InputError: `most` is below 1 or above the number of controls.
    """

    def __init__(self, rig: RigInMeshSpace, most: int | None = None) -> None:
        super().__init__(rig)
        controls = len(rig.rig.controls)
        self.most = controls if most is None else most
        if not 1 <= self.most <= controls:
            raise InputError(f"sampler: most is {most}, expected 1 to {controls}, the number of controls of '{rig.rig.name}'")

    def sample(self, count: int, generator: torch.Generator) -> Tensor:
        return sparse_controls(self.lower, self.upper, self.neutral, self.most, count, generator)


class PlausibleControls(ControlSampler):
    """Poses like those of performances: few active controls, often weak.

    The number of active controls is log-uniform, and a fraction of the poses is scaled towards neutral by a uniform factor: the
    paper's poses are rarely near neutral.

    Args:
        most: the greatest number of controls that leave neutral.
        faint: the share of poses that are scaled down as a whole.

    Raises:
        InputError: `most` or `faint` is out of range.
    """

    def __init__(self, rig: RigInMeshSpace, most: int = 40, faint: float = 0.5) -> None:
        super().__init__(rig)
        self.most, self.faint = min(most, len(rig.rig.controls)), faint
        check_plausible(most, faint)

    def sample(self, count: int, generator: torch.Generator) -> Tensor:
        active = choose(log_uniform_counts(count, self.most, generator), len(self.lower), generator)
        strength = faint_strength(count, self.faint, generator)
        change = (uniform(self.lower, self.upper, count, generator) - self.neutral) * strength
        return self.neutral + torch.where(active, change, 0.0)


def sparse_controls(lower: Tensor, upper: Tensor, neutral: Tensor, most: int, count: int, generator: torch.Generator) -> Tensor:
    """The paper's random controls `(count, control)`: how many leave neutral is uniform up to `most`, and so are their values.

    Args:
        lower, upper, neutral: `(control,)`.
    """
    active = choose(uniform_counts(count, most, generator), len(lower), generator)
    return torch.where(active, uniform(lower, upper, count, generator), neutral)


def check_plausible(most: int, faint: float) -> None:
    """Raises InputError where the numbers of a plausible sampler are out of range."""
    if most < 1:
        raise InputError(f"sampler: most is {most}, expected at least 1")
    if not 0 <= faint <= 1:
        raise InputError(f"sampler: faint is {faint}, expected a share from 0 to 1")


def choose(counts: Tensor, among: int, generator: torch.Generator) -> Tensor:
    """Random masks `(batch, among)` with `counts` `(batch,)` entries set in each row, all equally likely."""
    scores = torch.rand(len(counts), among, generator=generator, device=generator.device)
    threshold = scores.sort(dim=1).values.gather(1, counts[:, None] - 1)
    return scores <= threshold


def uniform_counts(count: int, most: int, generator: torch.Generator) -> Tensor:
    """Integers `(count,)`, uniform from 1 to `most`."""
    return torch.randint(1, most + 1, (count,), generator=generator, device=generator.device)


def log_uniform_counts(count: int, most: int, generator: torch.Generator) -> Tensor:
    """Integers `(count,)` from 1 to `most`, log-uniform."""
    exponent = torch.rand(count, generator=generator, device=generator.device) * math.log(most)
    return exponent.exp().round().long().clamp(1, most)


def faint_strength(count: int, share: float, generator: torch.Generator) -> Tensor:
    """Factors `(count, 1)`: 1, or for a share of them uniform in [0, 1]."""
    draws = torch.rand(count, 2, generator=generator, device=generator.device)
    return torch.where(draws[:, :1] < share, draws[:, 1:], 1.0)


def uniform(lower: Tensor, upper: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Values `(count, n)`, uniform between `lower` and `upper` `(n,)`."""
    draws = torch.rand(count, len(lower), generator=generator, device=generator.device, dtype=lower.dtype)
    return lower + (upper - lower) * draws
