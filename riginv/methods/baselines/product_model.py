"""An approximation of a rig that solvers can take apart: a sum of deltas, each times a product of functions of one control."""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.methods.baselines.sides import Sides

NONE = -1  # fills up the members of a product that has fewer than the longest


class Terms(NamedTuple):
    """Products and what they move.

    Attributes:
        members: the activations that each term multiplies, `(term, slot)`, `NONE` where a slot is empty.
        deltas: mesh coordinates of each, `(term, coordinate)`.
    """

    members: Tensor
    deltas: Tensor


class ProductModel:
    """Mesh coordinates = sum over terms of the product of its activations times its deltas.

    An activation is a function of the weight of one side (`riginv.methods.baselines.sides`), linear between evenly
    spaced knots: a ramp, a curve, or a hat that is 1 at one knot. Everything is in float64.

    Args:
        sides: of the rig that is approximated.
        side: whose function each activation is, `(activation,)`.
        table: its values at the knots, `(activation, knot)`, from weight 0 to 1.
    """

    def __init__(self, sides: Sides, side: Tensor, table: Tensor, terms: Terms) -> None:
        self.sides, self.side, self.table = sides, side, table
        self.members, self.deltas = terms
        self.terms_of_side = []
        padded = torch.cat([side, side.new_full((1,), NONE)])
        whose = padded[self.members]
        for number in range(len(sides)):
            self.terms_of_side.append((whose == number).any(dim=1).nonzero()[:, 0])
        self.in_slot = whose

    def extended(self, more: Terms) -> "ProductModel":
        """The model with further terms, whose members may be longer."""
        widths = self.members.shape[1], more.members.shape[1]
        members = [_widened(members, max(widths)) for members in (self.members, more.members)]
        terms = Terms(torch.cat(members), torch.cat([self.deltas, more.deltas]))
        return ProductModel(self.sides, self.side, self.table, terms)

    def activations(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Values and derivatives, both `(batch, activation)`, at weights `(batch, side)`."""
        pieces = self.table.shape[1] - 1
        place = weights[:, self.side] * pieces
        index = place.detach().floor().clamp(0, pieces - 1).long()
        row = torch.arange(len(self.side)).expand_as(index)
        start, end = self.table[row, index], self.table[row, index + 1]
        return start + (place - index) * (end - start), pieces * (end - start)

    def features(self, weights: Tensor) -> Tensor:
        """The products `(batch, term)` at weights `(batch, side)`."""
        values, _ = self.activations(weights)
        return _padded(values)[:, self.members].prod(dim=2)

    def coordinates(self, weights: Tensor) -> Tensor:
        """The mesh coordinates `(batch, coordinate)` at weights `(batch, side)`."""
        return self.features(weights) @ self.deltas

    def linearised(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """The coordinates `(batch, coordinate)`, and their derivative by every weight, `(batch, side, coordinate)`."""
        values, derivatives = self.activations(weights)
        factors = _padded(values)[:, self.members]
        derivatives = torch.cat([derivatives, derivatives.new_zeros(len(derivatives), 1)], dim=1)[:, self.members]
        slots = range(factors.shape[2])
        rises = [  # the product rule, in full: one summand for every slot
            derivatives[:, :, slot] * factors[:, :, [other for other in slots if other != slot]].prod(dim=2) for slot in slots
        ]
        jacobian = weights.new_zeros(len(weights), len(self.sides), self.deltas.shape[1])
        for side, terms in enumerate(self.terms_of_side):
            parts = (rise[:, terms] * (self.in_slot[terms, slot] == side) for slot, rise in enumerate(rises))
            by_side = sum(parts, weights.new_zeros(()))
            jacobian[:, side] = by_side @ self.deltas[terms]
        return factors.prod(dim=2) @ self.deltas, jacobian


def _padded(values: Tensor) -> Tensor:
    return torch.cat([values, values.new_ones(len(values), 1)], dim=1)


def _widened(members: Tensor, width: int) -> Tensor:
    missing = width - members.shape[1]
    return torch.cat([members, members.new_full((len(members), missing), NONE)], dim=1)
