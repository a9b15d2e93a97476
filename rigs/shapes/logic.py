"""From the weights of primary shapes to the weights of all shapes."""

from typing import Literal, get_args

import torch
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.blendshapes import combination_weights, smallest_weights
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
        self.combine = combination_weights if combination == "product" else smallest_weights
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
            positions.append(
                (order[name], position ** len(shapes.combinations[name]) if combination == "product" else position)
            )
        self._keep_hats("combination", positions)

    def forward(self, primary: Tensor) -> Tensor:
        """Weights of the primary shapes `(batch, primary)` to those of all shapes `(batch, shape)`, primary ones first."""
        between = hats(primary[:, self.inbetween_owner], self.inbetween_knots)
        combined = self.combine(torch.cat([primary, between], dim=1), self.members)
        return torch.cat([primary, between, combined, hats(combined[:, self.combination_owner], self.combination_knots)], dim=1)

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
