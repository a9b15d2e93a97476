"""Correlated controls, for natural poses of bodies."""

import re

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.config.values import Fraction, PositiveFloat
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import choose, log_uniform_counts
from riginv.sampling.controls import ControlSampler

SIDES = re.compile(r"left|right", re.IGNORECASE)
PROBE = 0.1  # displacement that shows which vertices a control moves, as a fraction of its range


class CorrelatedControls(ControlSampler):
    """A Gaussian around neutral: controls that act near each other are correlated, and so are left and right ones.

    The position of a control is the centre of the vertices that it moves near neutral; the covariance of two controls falls off
    with the distance of their positions. Controls named `left...` and `right...` move alike in a third of the poses, oppositely
    in a third, as in walking, and independently in the rest. In a fraction of the poses only some controls are active.

    Args:
        correlation_length: the distance at which the correlation is 0.6, as a fraction of the mesh's height.
        spread: the greatest standard deviation, as a fraction of the range on either side of neutral; each pose draws its own.
        sparse_fraction: the fraction of poses in which only some controls are active, their number log-uniform.

    Raises:
        InputError: a number is out of range.
    """

    mixing: Tensor
    other_side: Tensor

    def __init__(
        self,
        rig: RigInMeshSpace,
        correlation_length: PositiveFloat = 0.1,
        spread: PositiveFloat = 0.5,
        sparse_fraction: Fraction = 0.5,
    ) -> None:
        super().__init__(rig)
        if not (correlation_length > 0 and spread > 0 and 0 <= sparse_fraction <= 1):
            raise InputError(
                f"sampler: correlation_length {correlation_length} and spread {spread} must be above 0, "
                f"sparse_fraction {sparse_fraction} from 0 to 1"
            )
        self.spread, self.sparse_fraction = spread, sparse_fraction
        positions = control_positions(rig)
        rest = rig.space.rest_vertices
        height = (rest.amax(dim=0) - rest.amin(dim=0)).amax()
        covariance = torch.exp(-0.5 * (torch.cdist(positions, positions) / (correlation_length * height)).square()).double()
        values, vectors = torch.linalg.eigh(covariance)
        self.register_buffer("mixing", (vectors * values.clamp_min(0).sqrt()).T.to(rest), persistent=False)
        self.register_buffer("other_side", torch.tensor(other_sides(rig.source.control_names)), persistent=False)

    @classmethod
    def suits(cls, rig: LinearRig) -> bool:
        return not rig.has_blendshapes

    def sample(self, count: int, generator: torch.Generator) -> Float[Tensor, "count control"]:
        device, controls = generator.device, len(self.lower)
        draws = torch.randn(count, controls, generator=generator, device=device).to(self.lower) @ self.mixing
        together = torch.randint(-1, 2, (count, 1), generator=generator, device=device)
        mixed = (draws + together * draws[:, self.other_side]) / (1 + together.abs()).to(draws).sqrt()
        draws = torch.where(self.other_side == torch.arange(controls, device=device), draws, mixed)
        strength = self.spread * torch.rand(count, 1, generator=generator, device=device).to(draws)
        active = choose(log_uniform_counts(count, controls, generator), controls, generator)
        active = active | (torch.rand(count, 1, generator=generator, device=device) >= self.sparse_fraction)
        side = torch.where(draws >= 0, self.upper - self.neutral, self.neutral - self.lower)
        change = torch.where(active, strength * draws * side, 0.0)
        return torch.minimum(torch.maximum(self.neutral + change, self.lower), self.upper)


@torch.no_grad()
def control_positions(rig: RigInMeshSpace) -> Float[Tensor, "control 3"]:
    """The weighted centre `(control, 3)`, mm, of the rest vertices that each control moves near neutral."""
    backend = rig.source
    upwards = torch.where(backend.upper > backend.neutral_controls, backend.upper, backend.lower) - backend.neutral_controls
    moved = backend.neutral_controls + PROBE * torch.diag(upwards)
    squared = (rig.space.decode(rig(moved)) - rig.space.rest_vertices).square().sum(dim=2)
    return squared @ rig.space.rest_vertices / squared.sum(dim=1, keepdim=True).clamp_min(1e-12)


def other_sides(names: tuple[str, ...]) -> list[int]:
    """For each control the index of the one named `right` for `left`, or the reverse; its own where there is none."""
    number = {name: index for index, name in enumerate(names)}
    return [number.get(SIDES.sub(lambda found: _other(found[0]), name), number[name]) for name in names]


def _other(side: str) -> str:
    other = "right" if side.lower() == "left" else "left"
    return other.capitalize() if side[0].isupper() else other
