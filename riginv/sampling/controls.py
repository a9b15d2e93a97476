"""Samplers of controls."""

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.config.values import Fraction, PositiveInt
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import choose, log_uniform_counts, sparse_controls, uniform


class ControlSampler(nn.Module, ABC):
    """Draws random controls `(count, control)` within the limits of a rig."""

    lower: Tensor
    upper: Tensor
    neutral: Tensor

    def __init__(self, rig: RigInMeshSpace) -> None:
        super().__init__()
        self.register_buffer("lower", rig.source.lower, persistent=False)
        self.register_buffer("upper", rig.source.upper, persistent=False)
        self.register_buffer("neutral", rig.source.neutral_controls, persistent=False)

    @classmethod
    def suits(cls, rig: LinearRig) -> bool:
        """Whether a mixture for this rig includes this sampler (`riginv.sampling.meshes.select_for_rig`)."""
        return True

    @abstractmethod
    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "count control"]:
        """Controls `(count, control)`."""


class SparseControls(ControlSampler):
    """The paper's: the number of active controls and their values are uniform (paper, "Differentiable rig function").

    Args:
        max_active: the greatest number of controls that are not neutral; None: all of them.

    Raises:
        InputError: `max_active` is below 1 or above the number of controls.
    """

    def __init__(self, rig: RigInMeshSpace, max_active: PositiveInt | None = None) -> None:
        super().__init__(rig)
        controls = len(rig.source.controls)
        self.max_active = controls if max_active is None else max_active
        if not 1 <= self.max_active <= controls:
            raise InputError(
                f"sampler: max_active is {max_active}, expected 1 to {controls}, the number of controls of '{rig.source.name}'"
            )

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "count control"]:
        return sparse_controls(self.lower, self.upper, self.neutral, self.max_active, count, generator)


class PlausibleControls(ControlSampler):
    """Poses like those of performances: few active controls, often weak.

    The number of active controls is log-uniform, and a fraction of the poses is scaled towards neutral by a uniform factor: the
    paper's poses are rarely near neutral.

    Args:
        max_active: the greatest number of controls that are not neutral.
        weak_fraction: the fraction of poses that are scaled towards neutral.

    Raises:
        InputError: `max_active` or `weak_fraction` is out of range.
    """

    def __init__(self, rig: RigInMeshSpace, max_active: PositiveInt = 40, weak_fraction: Fraction = 0.5) -> None:
        super().__init__(rig)
        self.max_active, self.weak_fraction = min(max_active, len(rig.source.controls)), weak_fraction
        check_plausible(max_active, weak_fraction)

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "count control"]:
        active = choose(log_uniform_counts(count, self.max_active, generator), len(self.lower), generator)
        strength = random_strength(count, self.weak_fraction, generator)
        change = (uniform(self.lower, self.upper, count, generator) - self.neutral) * strength
        return self.neutral + torch.where(active, change, 0.0)


def check_plausible(max_active: int, weak_fraction: float) -> None:
    """Raises InputError where the arguments of a plausible sampler are out of range."""
    if max_active < 1:
        raise InputError(f"sampler: max_active is {max_active}, expected at least 1")
    if not 0 <= weak_fraction <= 1:
        raise InputError(f"sampler: weak_fraction is {weak_fraction}, expected a number from 0 to 1")


def random_strength(count: int, weak_fraction: float, generator: torch.Generator) -> Float[Tensor, "count 1"]:
    """Factors `(count, 1)`: 1, or for a fraction of them uniform in [0, 1]."""
    draws = torch.rand(count, 2, generator=generator, device=generator.device)
    return torch.where(draws[:, :1] < weak_fraction, draws[:, 1:], 1.0)
