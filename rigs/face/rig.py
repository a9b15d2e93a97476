"""The logic of the face rig: from controls to the weights of its shapes."""

import torch
from torch import Tensor

from riginv.geometry.blendshapes import combination_weights, screen
from riginv.geometry.curves import Curve, evaluate_curves, pack_curves
from riginv.geometry.kernels.library import kernels_for
from riginv.rig.arkit import ARKIT_NAMES
from riginv.rig.interface import LinearRig, Vjp
from riginv.rig.jacobian import Jacobian, Pattern
from rigs.face.build import face_geometry
from rigs.face.controls import build_controls
from rigs.face.derivatives import FaceSteps, patterns
from rigs.face.inbetweens import bump
from rigs.face.limits import CAPACITY, CEILINGS, REGIONS, cost, limit_curve, region
from rigs.face.looks import EXPRESSIONS, paint
from rigs.face.shapes import ARKIT_SPLIT, primary_names


class FaceRig(LinearRig):
    """A programmatic facial blendshape rig: 137 controls, 628 weights in [0, 1], 8,447 vertices; differentiable throughout.

    Controls drive primary shapes along Bezier curves; several drivers of one shape are combined by screen blending; the sum
    of weights of each region is limited; in-betweens follow the weight of their shape, combinations the product of two or
    three.
    """

    part: Tensor
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

    def __init__(self) -> None:
        geometry = face_geometry()
        controls, drivers = build_controls()
        shapes = primary_names()
        inbetween_shape, members = geometry["inbetween_shape"], geometry["combination_members"]
        positions = geometry["inbetween_position"].tolist()
        names = [
            *shapes,
            *(f"{shapes[shape]}{round(100 * position)}" for shape, position in zip(inbetween_shape.tolist(), positions)),
            *("_".join(shapes[shape] for shape in group if shape >= 0) for group in members.tolist()),
        ]
        rest, faces, basis = geometry["rest_vertices"], geometry["faces"], geometry["basis"]
        super().__init__("face", controls, rest, faces, basis, names, primary_count=len(shapes))

        control_order = {control.name: number for number, control in enumerate(controls)}
        order = {name: number for number, name in enumerate(shapes)}
        self._keep(
            part=geometry["part"],
            driver_control=torch.tensor([control_order[driver.control] for driver in drivers]),
            driver_of_shape=_slots([order[driver.shape] for driver in drivers], len(shapes)),
            ceiling_shape=torch.tensor([order[ceiling.shape] for ceiling in CEILINGS]),
            ceiling_under=torch.tensor([order[ceiling.under] for ceiling in CEILINGS]),
            region_of_shape=torch.tensor([REGIONS.index(region(name)) for name in shapes]),
            inbetween_shape=inbetween_shape,
            combination_members=members,
        )
        takes = torch.zeros(len(shapes), len(REGIONS))
        takes[torch.arange(len(shapes)), self.region_of_shape] = torch.tensor([cost(name) for name in shapes])
        counts = inbetween_shape.bincount()[inbetween_shape].tolist()
        self._patterns: dict[torch.device, tuple[Pattern, ...]] = {}
        self._logic: dict[torch.dtype, tuple[Tensor | int, ...]] = {}
        self._keep(
            capacity_taken=takes,
            driver_curves=self._curves([driver.curve for driver in drivers]),
            ceiling_curves=self._curves([ceiling.curve for ceiling in CEILINGS]),
            limit_curves=self._curves([limit_curve(CAPACITY[name]) for name in REGIONS]),
            inbetween_curves=self._curves([bump(position, count) for position, count in zip(positions, counts)]),
        )

        driven, ceilings, regions, betweens = len(drivers), len(CEILINGS), len(REGIONS), len(positions)
        self.counts = (len(shapes), betweens, len(members))  # of weights: primary shapes, in-betweens, combinations
        self.step_sizes = (driven, driven, len(shapes), ceilings, ceilings, regions, regions, len(shapes), betweens)

    def arkit_deltas(self) -> dict[str, Tensor]:
        row = {name: number for number, name in enumerate(self.coefficient_names)}
        halves = {name: (name + "Left", name + "Right") if name in ARKIT_SPLIT else (name,) for name in ARKIT_NAMES}
        zero = torch.zeros(())
        return {name: sum((self.basis[row[shape]] for shape in shapes), zero) for name, shapes in halves.items()}

    def expressions(self) -> dict[str, dict[str, float]]:
        return EXPRESSIONS

    def vertex_colors(self) -> Tensor:
        return paint(self.rest_vertices, self.part)

    def _keep(self, **tensors: Tensor) -> None:
        for name, tensor in tensors.items():
            self.register_buffer(name, tensor, persistent=False)

    def _curves(self, curves: list[Curve]) -> Tensor:
        return pack_curves(curves).to(self.dtype)

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, 137)` to the weights `(batch, 628)` of primary shapes, in-betweens and combinations."""
        if not (controls.requires_grad and torch.is_grad_enabled()) and kernels_for(controls) is not None:
            return FaceSteps(self, controls).weights
        driven = evaluate_curves(self.driver_curves.to(controls), controls.index_select(1, self.driver_control))
        primary = screen(driven, self.driver_of_shape)
        under = evaluate_curves(self.ceiling_curves.to(controls), primary.index_select(1, self.ceiling_under))
        primary = primary.index_copy(1, self.ceiling_shape, torch.minimum(primary.index_select(1, self.ceiling_shape), under))
        yielding = evaluate_curves(self.limit_curves.to(controls), primary @ self.capacity_taken.to(controls))
        primary = primary * yielding.index_select(1, self.region_of_shape)
        between = evaluate_curves(self.inbetween_curves.to(controls), primary.index_select(1, self.inbetween_shape))
        return torch.cat([primary, between, combination_weights(primary, self.combination_members)], dim=1)

    def logic(self, controls: Tensor) -> tuple[Tensor | int, ...]:
        """The first arguments of the kernels `shapes` and `shapes_pull`, in the precision of controls."""
        if controls.dtype not in self._logic:
            drivers, ceilings, limits, betweens = (
                (table.to(controls).contiguous(), *table.shape[:2])
                for table in (self.driver_curves, self.ceiling_curves, self.limit_curves, self.inbetween_curves)
            )
            sources, members = (
                (table.to(controls.device).contiguous(), *table.shape)
                for table in (self.driver_of_shape, self.combination_members)
            )
            cost = self.capacity_taken.to(controls).sum(dim=1)  # of a shape's own region only
            ceiling = (*ceilings, self.ceiling_shape, self.ceiling_under)
            self._logic[controls.dtype] = (
                *(*drivers, self.driver_control, *sources, *ceiling),
                *(*limits, self.region_of_shape, cost, *betweens, self.inbetween_shape, *members),
            )
        return self._logic[controls.dtype]

    @torch.no_grad()
    def coefficients_and_vjp(self, controls: Tensor) -> tuple[Tensor, Vjp]:
        steps = FaceSteps(self, controls)
        return steps.weights, steps.vjp

    @torch.no_grad()
    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        steps = FaceSteps(self, controls)
        if controls.device not in self._patterns:
            self._patterns[controls.device] = patterns(self, controls.device)
        return steps.weights, steps.jacobian(self._patterns[controls.device])


def _slots(owners: list[int], count: int) -> Tensor:
    """Indices `(owner, slot)` at which each of `count` owners occurs in `owners`, padded with -1."""
    indices = [[index for index, owner in enumerate(owners) if owner == number] for number in range(count)]
    longest = max(len(row) for row in indices)
    return torch.tensor([row + [-1] * (longest - len(row)) for row in indices])
