"""The logic of the face with the derivative of every step."""

from typing import TYPE_CHECKING

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
from riginv.geometry.kernels.library import Kernels, kernels_for, plain_rows
from riginv.rig.jacobian import Factor, Jacobian, Pattern

if TYPE_CHECKING:
    from rigs.face.rig import FaceRig


class FaceSteps:
    """One evaluation of `FaceRig.coefficients`, step by step, without autograd.

    Args:
        face: the rig.
        controls: `(batch, control)`.

    Attributes:
        weights: of all shapes, `(batch, shape)`.
    """

    def __init__(self, face: "FaceRig", controls: Tensor) -> None:
        self.face, self.controls = face, controls
        self.taken = face.capacity_taken.to(controls)
        self.counts = face.counts
        self.compiled = kernels_for(controls)
        self.state: Tensor | None = None
        if self.compiled is None:
            self._evaluate(face, controls)
        else:
            self._evaluate_compiled(self.compiled, face, controls)

    def _evaluate_compiled(self, compiled: Kernels, face: "FaceRig", controls: Tensor) -> None:
        """The steps by a kernel, which leaves their results in one tensor."""
        rows, batch = plain_rows(controls), controls.shape[0]
        self.state = rows.new_empty(batch * sum(face.step_sizes))
        self.weights = rows.new_empty(batch, sum(self.counts))
        self.logic = face.logic(controls)
        compiled.call("shapes", rows.dtype, *self.logic, rows, rows.stride(0), self.state, self.weights, batch)

    def _name_steps(self) -> None:
        """The results of the steps, as views of what the kernel has left; kernels do without these."""
        if self.state is None or hasattr(self, "driven"):
            return
        batch = len(self.weights)
        parts = self.state.split([batch * size for size in self.face.step_sizes])
        steps = [part.view(batch, size) for part, size in zip(parts, self.face.step_sizes)]
        self.driven, self.rise, self.limited, self.below, self.under_derivative = steps[:5]
        self.yielding, self.yield_derivative, self.factor, self.bump_derivative = steps[5:]
        self.primary = self.weights[:, : self.counts[0]]

    def _evaluate(self, face: "FaceRig", controls: Tensor) -> None:
        self.driven, self.rise = curves_and_derivatives(
            face.driver_curves.to(controls), controls.index_select(1, face.driver_control)
        )
        screened = screen(self.driven, face.driver_of_shape)
        close = screened.index_select(1, face.ceiling_shape)
        under, self.under_derivative = curves_and_derivatives(
            face.ceiling_curves.to(controls), screened.index_select(1, face.ceiling_under)
        )
        self.below = (close <= under).to(controls)  # whether a shape with a ceiling is below it
        self.limited = screened.index_copy(1, face.ceiling_shape, torch.minimum(close, under))
        self.yielding, self.yield_derivative = curves_and_derivatives(face.limit_curves.to(controls), self.limited @ self.taken)
        self.factor = self.yielding.index_select(1, face.region_of_shape)
        self.primary = self.limited * self.factor
        between, self.bump_derivative = curves_and_derivatives(
            face.inbetween_curves.to(controls), self.primary.index_select(1, face.inbetween_shape)
        )
        combined = combination_weights(self.primary, face.combination_members)
        self.weights = torch.cat([self.primary, between, combined], dim=1)

    @torch.no_grad()
    def vjp(self, gradient: Tensor) -> Tensor:
        """Vector-Jacobian product: a gradient `(batch, shape)` of the weights to one of the controls, `(batch, control)`."""
        face = self.face
        if self.compiled is not None and self.state is not None and kernels_for(self.state, gradient) is not None:
            gradient, found = plain_rows(gradient), torch.empty_like(self.controls, memory_format=torch.contiguous_format)
            given = (self.state, self.weights, gradient, gradient.stride(0), found, found.shape[1], len(found))
            self.compiled.call("shapes_pull", found.dtype, *self.logic, *given)
            return found
        self._name_steps()
        of_primary, of_between, of_combined = gradient.split(self.counts, dim=1)
        pulled = combination_vjp(self.primary, face.combination_members, of_combined).add_(of_primary)
        add_to_columns(pulled, face.inbetween_shape, of_between, self.bump_derivative)
        of_yielding = add_to_columns(torch.zeros_like(self.yielding), face.region_of_shape, pulled, self.limited)
        pulled = torch.addmm(pulled * self.factor, of_yielding * self.yield_derivative, self.taken.T)
        of_close = pulled.index_select(1, face.ceiling_shape)
        pulled.index_copy_(1, face.ceiling_shape, of_close * self.below)
        add_to_columns(pulled, face.ceiling_under, of_close * (1 - self.below), self.under_derivative)
        of_driven = screen_vjp(self.driven, face.driver_of_shape, pulled)
        return add_to_columns(torch.zeros_like(self.controls), face.driver_control, of_driven, self.rise)

    def jacobian(self, patterns: tuple[Pattern, ...]) -> Jacobian:
        """Jacobian of the weights by the controls, with entries at the positions of `patterns`."""
        self._name_steps()
        face, slots = self.face, self.face.driver_of_shape.shape[1]
        rises = self.rise.index_select(1, face.driver_of_shape.flatten().clamp_min(0))
        of_drivers = screen_derivatives(self.driven, face.driver_of_shape).flatten(1) * rises
        of_under = of_drivers.unflatten(1, (-1, slots)).index_select(1, face.ceiling_under) * self.under_derivative[..., None]
        passes = torch.ones_like(self.limited).index_copy_(1, face.ceiling_shape, self.below).repeat_interleave(slots, dim=1)
        of_limited = torch.cat([of_drivers * passes, (of_under * (1 - self.below)[..., None]).flatten(1)], dim=1)
        takes = self.taken.sum(dim=1)  # of its own region only
        takes = torch.cat([takes, takes.index_select(0, face.ceiling_shape)]).repeat_interleave(slots)
        products = combination_derivatives(self.primary, face.combination_members).flatten(1)
        derivative = self.yield_derivative.index_select(1, face.region_of_shape)
        values = (
            torch.cat([torch.ones_like(self.primary), self.bump_derivative, products], dim=1),
            torch.cat([self.factor, self.limited * derivative], dim=1),
            torch.cat([of_limited, of_limited * takes], dim=1),
        )
        return Jacobian(tuple(Factor(pattern, each.index_select(1, pattern.kept)) for pattern, each in zip(patterns, values)))


def patterns(face: "FaceRig", device: torch.device) -> tuple[Pattern, ...]:
    """Positions of the entries of the Jacobian's factors.

    The first factor is the derivative of all weights by those of primary shapes; the second of these by their values before
    regions were limited and by the sums of the regions; the third of both by the controls.
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
    limited = torch.cat([each, face.ceiling_shape]).repeat_interleave(slots)
    driver = face.driver_of_shape[torch.cat([each, face.ceiling_under])].flatten()
    control = torch.where(driver >= 0, face.driver_control[driver.clamp_min(0)], -1)
    return (
        Pattern(rows, follows, (shapes + betweens + products, shapes)),
        Pattern(torch.cat([each, each]), torch.cat([each, total]), (shapes, shapes + regions)),
        Pattern(torch.cat([limited, total[limited]]), torch.cat([control, control]), (shapes + regions, controls)),
    )
