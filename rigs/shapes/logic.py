"""From the weights of primary shapes to the weights of all shapes."""

from typing import Literal, get_args

import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.blendshapes import combination_derivatives, combination_weights, smallest_weights
from riginv.rig.jacobian import Factor, Jacobian, Pattern
from rigs.shapes.names import Convention

Combination = Literal["product", "min"]


class ShapeLogic(nn.Module):
    """Weights of in-betweens and combinations.

    Args:
        shapes: kind of each shape.
        combination: weight of a combination: `product` or `min` of the weights of its parts.

    Raises:
        InputError: `combination` is something else.
    """

    members: Tensor
    inbetween_owner: Tensor
    inbetween_knots: Tensor
    combination_owner: Tensor
    combination_knots: Tensor

    def __init__(self, shapes: Convention, combination: Combination = "product") -> None:
        super().__init__()
        if combination not in get_args(Combination):
            raise InputError(f"rig.combination is '{combination}', expected {' or '.join(get_args(Combination))}")
        is_product = combination == "product"
        self.combine = combination_weights if is_product else smallest_weights
        self.derive = combination_derivatives if is_product else smallest_derivatives
        self.primaries = len(shapes.primaries)
        self._patterns: dict[torch.device, tuple[Pattern, ...]] = {}
        sources = [*shapes.primaries, *shapes.inbetweens]
        most = max((len(members) for members in shapes.combinations.values()), default=1)
        members = [[sources.index(part) for part in group] for group in shapes.combinations.values()]
        padded = [row + [-1] * (most - len(row)) for row in members]
        self._keep(members=torch.tensor(padded, dtype=torch.long).reshape(-1, most))
        order = {name: number for number, name in enumerate(shapes.primaries)}
        self._keep_hats("inbetween", [(order[shape], position) for shape, position in shapes.inbetweens.values()])
        order = {name: number for number, name in enumerate(shapes.combinations)}
        positions = []
        for name, position in shapes.combination_inbetweens.values():
            positions.append((order[name], position ** len(shapes.combinations[name]) if is_product else position))
        self._keep_hats("combination", positions)

    def forward(self, primary: Tensor) -> Tensor:
        """Weights of the primary shapes `(batch, primary)` to those of all shapes `(batch, shape)`, primary ones first."""
        between = hats(primary[:, self.inbetween_owner], self.inbetween_knots)
        combined = self.combine(torch.cat([primary, between], dim=1), self.members)
        return torch.cat([primary, between, combined, hats(combined[:, self.combination_owner], self.combination_knots)], dim=1)

    @torch.no_grad()
    def with_jacobian(self, primary: Tensor) -> tuple[Tensor, Jacobian]:
        """As `forward`, and the Jacobian `(batch, shape, primary)`."""
        between, rise = hats_and_slopes(primary[:, self.inbetween_owner], self.inbetween_knots)
        parts = torch.cat([primary, between], dim=1)
        combined = self.combine(parts, self.members)
        upper, upper_rise = hats_and_slopes(combined[:, self.combination_owner], self.combination_knots)
        ones = torch.ones_like(torch.cat([parts, combined], dim=1))
        values = [
            torch.cat([ones, upper_rise], dim=1),
            torch.cat([torch.ones_like(parts), self.derive(parts, self.members).flatten(1)], dim=1),
            torch.cat([torch.ones_like(primary), rise], dim=1),
        ]
        if primary.device not in self._patterns:
            self._patterns[primary.device] = self._make_patterns()
        factors = [Factor(pattern, each[:, pattern.kept]) for pattern, each in zip(self._patterns[primary.device], values)]
        of_all = 0 if len(self.combination_owner) else 1  # without in-betweens of combinations the first factor is the identity
        return torch.cat([parts, combined, upper], dim=1), Jacobian(tuple(factors[of_all:]))

    def _make_patterns(self) -> tuple[Pattern, ...]:
        """Positions of the entries: of all shapes by all but in-betweens of combinations, by parts, by primary shapes."""
        parts = self.primaries + len(self.inbetween_owner)
        products, most = self.members.shape
        before = parts + products
        sizes = (before + len(self.combination_owner), before, parts, self.primaries)
        sources = (parts + self.combination_owner, self.members.flatten(), self.inbetween_owner)
        patterns = []
        for rows, columns, source, slots in zip(sizes, sizes[1:], sources, (1, most, 1)):
            each = torch.arange(columns, device=source.device)
            further = torch.arange(columns, rows, device=source.device).repeat_interleave(slots)
            patterns.append(Pattern(torch.cat([each, further]), torch.cat([each, source]), (rows, columns)))
        return tuple(patterns)

    def _keep(self, **tensors: Tensor) -> None:
        for name, tensor in tensors.items():
            self.register_buffer(name, tensor, persistent=False)

    def _keep_hats(self, kind: str, positions: list[tuple[int, float]]) -> None:
        """Register the owner and the three knots of each in-between: its neighbours on the path, and itself."""
        knots = []
        for owner, position in positions:
            path = [0.0, *sorted(other for of, other in positions if of == owner), 1.0]
            number = path.index(position)
            knots.append([path[number - 1], position, path[number + 1]])
        self._keep(**{f"{kind}_owner": torch.tensor([owner for owner, _ in positions], dtype=torch.long)})
        self._keep(**{f"{kind}_knots": torch.tensor(knots, dtype=torch.float64).reshape(-1, 3)})


def hats(weights: Tensor, knots: Tensor) -> Tensor:
    """Hat functions: 1 at the middle knot, falling linearly to 0 at the knots on either side, and 0 beyond.

    Args:
        weights: `(batch, hat)`.
        knots: `(hat, 3)`, ascending.

    Returns:
        `(batch, hat)` in [0, 1]. At 0 the derivative is that of the rising side, for a gradient at rest.
    """
    left, middle, right = knots.to(weights).unbind(1)
    return torch.minimum((weights - left) / (middle - left), (right - weights) / (right - middle)).clamp_min(0)


def hats_and_slopes(weights: Tensor, knots: Tensor) -> tuple[Tensor, Tensor]:
    """As `hats`, and the derivatives `(batch, hat)`: of the rising side at the middle knot and at the left one."""
    left, middle, right = knots.to(weights).unbind(1)
    slopes = torch.where(weights <= middle, 1 / (middle - left), -1 / (right - middle))
    return hats(weights, knots), torch.where((weights >= left) & (weights <= right), slopes, 0.0)


def smallest_derivatives(weights: Tensor, members: Tensor) -> Tensor:
    """The derivative `(batch, combination, slot)` of each of `smallest_weights` by the weight of each member."""
    padded = torch.cat([weights, weights.new_full((len(weights), 1), torch.inf)], dim=1)
    smallest = padded[:, members].argmin(dim=2, keepdim=True)
    return torch.zeros_like(padded[:, members]).scatter_(2, smallest, 1.0)
