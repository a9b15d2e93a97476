"""The face's logic with the derivative of every step."""

from typing import Protocol

import torch
from torch import Tensor

from riginv.geometry.blendshapes import (
    add_to_columns,
    combination_derivatives,
    combination_vjp,
    combination_weights,
    screen,
    screen_derivatives,
    screen_vjp,
)
from riginv.geometry.curves import curves_and_derivatives
from riginv.rig.jacobian import Factor, Jacobian, Pattern


class Logic(Protocol):
    """The tables of a face's logic, as `rigs.face.rig.FaceRig` holds them."""

    driver_curves: Tensor
    driver_control: Tensor
    driver_of_shape: Tensor
    ceiling_curves: Tensor
    ceiling_shape: Tensor
    ceiling_under: Tensor
    capacity_taken: Tensor
    limit_curves: Tensor
    region_of_shape: Tensor
    inbetween_curves: Tensor
    inbetween_shape: Tensor
    combination_members: Tensor


class FaceSteps:
    """One evaluation: what `FaceRig.coefficients` gives, step by step, without a graph.

    Args:
        face: the face.
        controls: `(batch, control)`.

    Attributes:
        weights: of all shapes, `(batch, shape)`.
    """

    def __init__(self, face: Logic, controls: Tensor) -> None:
        self.face = face
        self.driven, self.rise = curves_and_derivatives(
            face.driver_curves.to(controls), controls.index_select(1, face.driver_control)
        )
        screened = screen(self.driven, face.driver_of_shape)
        close = screened.index_select(1, face.ceiling_shape)
        under, self.under_derivative = curves_and_derivatives(
            face.ceiling_curves.to(controls), screened.index_select(1, face.ceiling_under)
        )
        self.free = (close <= under).to(controls)  # whether a shape with a ceiling is below it
        self.held = screened.index_copy(1, face.ceiling_shape, torch.minimum(close, under))
        self.taken = face.capacity_taken.to(controls)
        self.yielding, self.yield_derivative = curves_and_derivatives(face.limit_curves.to(controls), self.held @ self.taken)
        self.factor = self.yielding.index_select(1, face.region_of_shape)
        self.primary = self.held * self.factor
        between, self.bump_derivative = curves_and_derivatives(
            face.inbetween_curves.to(controls), self.primary.index_select(1, face.inbetween_shape)
        )
        combined = combination_weights(self.primary, face.combination_members)
        self.counts = (self.primary.shape[1], between.shape[1], combined.shape[1])
        self.weights = torch.cat([self.primary, between, combined], dim=1)
        self.controls = controls

    @torch.no_grad()
    def vjp(self, gradient: Tensor) -> Tensor:
        """A gradient `(batch, shape)` of the weights as one of the controls, `(batch, control)`: the steps backwards."""
        face = self.face
        of_primary, of_between, of_combined = gradient.split(self.counts, dim=1)
        pulled = combination_vjp(self.primary, face.combination_members, of_combined).add_(of_primary)
        add_to_columns(pulled, face.inbetween_shape, of_between, self.bump_derivative)
        of_yielding = add_to_columns(torch.zeros_like(self.yielding), face.region_of_shape, pulled, self.held)
        pulled = torch.addmm(pulled * self.factor, of_yielding * self.yield_derivative, self.taken.T)
        of_close = pulled.index_select(1, face.ceiling_shape)
        pulled.index_copy_(1, face.ceiling_shape, of_close * self.free)
        add_to_columns(pulled, face.ceiling_under, of_close * (1 - self.free), self.under_derivative)
        of_driven = screen_vjp(self.driven, face.driver_of_shape, pulled)
        return add_to_columns(torch.zeros_like(self.controls), face.driver_control, of_driven, self.rise)

    def jacobian(self, patterns: tuple[Pattern, ...]) -> Jacobian:
        """The derivative of the weights by the controls, with entries in the places that `patterns` gives."""
        face, slots = self.face, self.face.driver_of_shape.shape[1]
        rises = self.rise.index_select(1, face.driver_of_shape.flatten().clamp_min(0))
        of_drivers = screen_derivatives(self.driven, face.driver_of_shape).flatten(1) * rises
        of_under = of_drivers.unflatten(1, (-1, slots)).index_select(1, face.ceiling_under) * self.under_derivative[..., None]
        passes = torch.ones_like(self.held).index_copy_(1, face.ceiling_shape, self.free).repeat_interleave(slots, dim=1)
        of_held = torch.cat([of_drivers * passes, (of_under * (1 - self.free)[..., None]).flatten(1)], dim=1)
        takes = self.taken.sum(dim=1)  # each shape takes of its own region alone
        takes = torch.cat([takes, takes.index_select(0, face.ceiling_shape)]).repeat_interleave(slots)
        products = combination_derivatives(self.primary, face.combination_members).flatten(1)
        derivative = self.yield_derivative.index_select(1, face.region_of_shape)
        values = (
            torch.cat([torch.ones_like(self.primary), self.bump_derivative, products], dim=1),
            torch.cat([self.factor, self.held * derivative], dim=1),
            torch.cat([of_held, of_held * takes], dim=1),
        )
        return Jacobian(tuple(Factor(pattern, each.index_select(1, pattern.kept)) for pattern, each in zip(patterns, values)))


def patterns(face: Logic, device: torch.device) -> tuple[Pattern, ...]:
    """Where the factors of the Jacobian have entries.

    The first are all weights by those of primary shapes; the second these by what they were before their region was limited
    and by the region's sum; the third both by the controls.
    """
    shapes, slots = face.driver_of_shape.shape
    betweens, (products, most), regions = (
        len(face.inbetween_shape),
        face.combination_members.shape,
        face.capacity_taken.shape[1],
    )
    controls = int(face.driver_control.max()) + 1
    each = torch.arange(shapes, device=device)
    corrective = torch.arange(shapes, shapes + betweens + products, device=device)
    rows = torch.cat([each, corrective[:betweens], corrective[betweens:].repeat_interleave(most)])
    follows = torch.cat([each, face.inbetween_shape, face.combination_members.flatten()])
    total = shapes + face.region_of_shape
    held = torch.cat([each, face.ceiling_shape]).repeat_interleave(slots)
    driver = face.driver_of_shape[torch.cat([each, face.ceiling_under])].flatten()
    control = torch.where(driver >= 0, face.driver_control[driver.clamp_min(0)], -1)
    return (
        Pattern(rows, follows, (shapes + betweens + products, shapes)),
        Pattern(torch.cat([each, each]), torch.cat([each, total]), (shapes, shapes + regions)),
        Pattern(torch.cat([held, total[held]]), torch.cat([control, control]), (shapes + regions, controls)),
    )
