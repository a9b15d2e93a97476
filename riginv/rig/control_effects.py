"""Displacements of the mesh by each control, from the Jacobian of a rig in several poses, and controls with equal effects."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.jacobian import finite_differences
from riginv.rig.mesh_space import inner_products
from riginv.rig.random_controls import sparse_controls, uniform

POSES, MAX_ACTIVE, SEED = 4, 10, 20221206  # random poses of each kind
MAX_COEFFICIENTS = 2000  # of a rig whose Jacobian is taken through its basis: more cost more than its vertices
SAME_COSINE = 0.999  # of the displacements of two controls that the mesh does not distinguish
STILL_MM = 2e-3  # root mean square displacement over the range of a control that moves nothing: above rounding


@dataclass(frozen=True)
class ControlEffects:
    """The motion of the mesh by each control; controls that the mesh does not distinguish are merged into one column.

    Attributes:
        names: of the columns: those of merged controls are joined by `=`. Where one side of a control that is neutral inside
            its range is merged, each side has a column: `jawSide+` above neutral, `jawSide-` below.
        merge: `(2 * control, column)`: from distances above neutral, and then below it, in fractions of the ranges, to those of
            the columns, in fractions of the range of the control of a column that moves the mesh most.
        gram: `(column, column)`, mm^2: the mean inner product over the vertices of the displacements by two columns over their
            ranges, averaged over poses.
        merged: the names of controls that the mesh does not distinguish, group by group.
        without_effect: the names of controls that move no vertex in any of the poses; they have no column.
        neutral, span: the neutral values and the ranges of the controls, `(control,)`.
    """

    names: tuple[str, ...]
    merge: Tensor
    gram: Tensor
    merged: tuple[tuple[str, ...], ...]
    without_effect: tuple[str, ...]
    neutral: Tensor
    span: Tensor

    @classmethod
    @torch.no_grad()
    def of_rig(cls, rig: RigBackend) -> "ControlEffects":
        """The effects of a rig's controls, by finite differences: for rigs without gradients, too."""
        measured = _Displacements.of_rig(rig)
        sides = measured.distinct_sides()
        grams, valid = measured.grams_of(sides)
        gram = grams.sum(dim=0) / valid.sum(dim=0).clamp_min(1)
        mean_sizes, groups = gram.diagonal().sqrt(), measured.groups(sides)
        names, columns, kept = [side.name(rig.control_names) for side in sides], [], []
        for group in groups:
            largest = max(group, key=lambda side: float(mean_sizes[side]))
            column = torch.zeros(2, len(rig.controls), dtype=gram.dtype)
            for side in group:
                value = gram[largest, side].sign() * mean_sizes[side] / mean_sizes[largest]
                column[:, sides[side].control] += value * torch.tensor(sides[side].directions)
            kept.append(largest)
            columns.append(column.flatten())
        moving = {sides[side].control for group in groups for side in group}
        return cls(
            names=tuple(" = ".join(names[side] for side in group) for group in groups),
            merge=torch.stack(columns, dim=1) if columns else gram.new_zeros(2 * len(rig.controls), 0),
            gram=gram[kept][:, kept],
            merged=tuple(tuple(names[side] for side in group) for group in groups if len(group) > 1),
            without_effect=tuple(name for control, name in enumerate(rig.control_names) if control not in moving),
            neutral=rig.neutral_controls.cpu().double(),
            span=(rig.upper - rig.lower).cpu().double(),
        )

    @property
    def sizes_mm(self) -> Float[Tensor, " column"]:
        """The root mean square displacement of the vertices by each column over its range, `(column,)`, mm."""
        return self.gram.diagonal().sqrt()

    def columns_of(self, controls: Float[Tensor, "frame control"]) -> Float[Tensor, "frame column"]:
        """Controls `(frame, control)` as distances from neutral in fractions of the ranges, merged: `(frame, column)`."""
        away = (controls.detach().cpu().double() - self.neutral) / self.span
        return torch.cat([away.clamp_min(0), (-away).clamp_min(0)], dim=1) @ self.merge


class _Side(NamedTuple):
    """A control (sign 0), or that control above neutral (1) or below it (-1)."""

    control: int
    sign: int = 0

    @property
    def directions(self) -> tuple[float, float]:
        """By how much a distance above neutral, and one below it, count."""
        return {0: (1.0, -1.0), 1: (1.0, 0.0), -1: (0.0, 1.0)}[self.sign]

    def name(self, controls: Sequence[str]) -> str:
        return controls[self.control] + ("", "+", "-")[self.sign]


class _Displacements(NamedTuple):
    """The displacements by controls over their ranges, in several poses.

    Attributes:
        grams: their mean inner products over the vertices, `(pose, control, control)`, mm^2.
        away: the poses as distances from neutral, `(pose, control)`.
        two_sided: the controls that are neutral inside their ranges.
    """

    grams: Tensor
    away: Tensor
    two_sided: list[int]

    @classmethod
    def of_rig(cls, rig: RigBackend) -> "_Displacements":
        poses, neutral = _poses(rig), rig.neutral_controls
        inside = (neutral > rig.lower) & (neutral < rig.upper)
        return cls(_grams(rig, poses), (poses - neutral).cpu(), inside.nonzero()[:, 0].tolist())

    def distinct_sides(self) -> list[_Side]:
        """All controls, those by their sides of which one side does what another control does."""
        whole = [_Side(control) for control in range(self.away.shape[1])]
        alone = {group[0] for group in self.groups(whole) if len(group) == 1}
        split = _split(whole, alone.intersection(self.two_sided))
        merged = [split[side] for group in self.groups(split) if len(group) > 1 for side in group]
        return _split(whole, {side.control for side in merged if side.sign})

    def grams_of(self, sides: list[_Side]) -> tuple[Tensor, Tensor]:
        """Inner products and whether they are valid, both `(pose, side, side)`; invalid (0): a control is not on that side."""
        controls, signs = [side.control for side in sides], torch.tensor([side.sign for side in sides])
        valid = (signs == 0) | (self.away[:, controls] * signs > 0)
        both = valid[:, :, None] & valid[:, None, :]
        directions = torch.where(signs < 0, -1.0, 1.0).double()
        grams = self.grams[:, controls][:, :, controls] * directions[:, None] * directions
        return torch.where(both, grams, 0.0), both

    def groups(self, sides: list[_Side]) -> list[list[int]]:
        """The indices of sides that move the mesh, those with parallel displacements in every pose together."""
        grams, valid = self.grams_of(sides)
        sizes = grams.diagonal(dim1=1, dim2=2).sqrt()
        moves = sizes > STILL_MM
        cosines = grams.abs() / (sizes[:, :, None] * sizes[:, None, :]).clamp_min(1e-12)
        both = moves[:, :, None] & moves[:, None, :] & valid
        neither = ~moves[:, :, None] & ~moves[:, None, :]
        same = ((both & (cosines > SAME_COSINE)) | neither | ~valid).all(dim=0) & both.any(dim=0)
        groups: list[list[int]] = []
        for side in moves.any(dim=0).nonzero()[:, 0].tolist():
            twin = next((group for group in groups if bool(same[group[0], side])), None)
            groups.append([side]) if twin is None else twin.append(side)
        return groups


def _split(sides: list[_Side], controls: set[int]) -> list[_Side]:
    """The same, some controls by their two sides."""
    return [_Side(one, sign) for one, _ in sides for sign in ((1, -1) if one in controls else (0,))]


def _poses(rig: RigBackend) -> Tensor:
    """Neutral, sparse poses, and poses of all controls at once: some act with others alone, some otherwise below neutral."""
    lower, upper, neutral = rig.lower.cpu(), rig.upper.cpu(), rig.neutral_controls.cpu()
    generator, active = generator_at(SEED, "control effects"), min(MAX_ACTIVE, len(rig.controls))
    sparse = sparse_controls(lower, upper, neutral, active, POSES, generator)
    dense = uniform(lower, upper, POSES // 2, generator)
    dense = torch.lerp(neutral, torch.cat([dense, lower + upper - dense]), 0.6)
    return torch.cat([neutral[None], sparse, dense]).to(rig.lower)


def _grams(rig: RigBackend, poses: Tensor) -> Tensor:
    """Inner products `(pose, control, control)`, mm^2, of the displacements by controls over their ranges, over vertices."""
    span, count = rig.upper - rig.lower, len(rig.rest_vertices)
    if isinstance(rig, LinearRig) and len(rig.basis) <= MAX_COEFFICIENTS:
        jacobian = finite_differences(rig.coefficients, poses, rig.lower, rig.upper)[1].scaled(span)
        return jacobian.gram(inner_products(rig.basis, rig.basis)).cpu().double() / count
    found = []
    for pose in poses.split(1):
        jacobian = finite_differences(lambda controls: rig(controls).flatten(1), pose, rig.lower, rig.upper)[1]
        displacements = jacobian.scaled(span).dense()[0]
        found.append((displacements.T @ displacements).cpu().double() / count)
    return torch.stack(found)
