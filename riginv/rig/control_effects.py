"""Displacements of the mesh by each control, from the Jacobian of a rig in several poses, and controls with equal effects."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.jacobian import finite_differences
from riginv.rig.random_controls import sparse_controls, uniform

POSES, MAX_ACTIVE, SEED = 4, 10, 20221206  # random poses of each kind
MAX_COEFFICIENTS = 2000  # of a rig whose Jacobian is taken through its basis: more cost more than its vertices
SAME_COSINE = 0.999  # of the displacements of two controls that the mesh does not distinguish
STILL_MM = 2e-3  # root mean square displacement over the range of a control that moves nothing: above rounding


@dataclass(frozen=True)
class ControlEffects:
    """The motion of the mesh by each control; controls that the mesh does not distinguish are merged into one column.

    Attributes:
        names: of the columns: those of merged controls are joined by `=`.
        merge: `(control, column)`: from values in fractions of the ranges to those of the columns, in fractions of the range of
            the control of a column that moves the mesh most.
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
        """The effects of a rig's controls, by finite differences, so that it need not be differentiable."""
        grams = _grams(rig)
        sizes = grams.diagonal(dim1=1, dim2=2).sqrt()
        gram, moves = grams.mean(dim=0), sizes > STILL_MM
        mean_sizes, names = gram.diagonal().sqrt(), rig.control_names
        columns, groups = [], _groups(grams, sizes, moves)
        for group in groups:
            largest = max(group, key=lambda control: float(mean_sizes[control]))
            column = torch.zeros(len(names), dtype=gram.dtype)
            column[group] = gram[largest, group].sign() * mean_sizes[group] / mean_sizes[largest]
            columns.append((largest, column))
        kept = [largest for largest, _ in columns]
        merge = torch.stack([column for _, column in columns], dim=1) if columns else gram[:, :0]
        return cls(
            names=tuple(" = ".join(names[control] for control in group) for group in groups),
            merge=merge,
            gram=gram[kept][:, kept],
            merged=tuple(tuple(names[control] for control in group) for group in groups if len(group) > 1),
            without_effect=tuple(name for name, moved in zip(names, moves.any(dim=0).tolist()) if not moved),
            neutral=rig.neutral_controls.cpu().double(),
            span=(rig.upper - rig.lower).cpu().double(),
        )

    @property
    def sizes_mm(self) -> Float[Tensor, " column"]:
        """The root mean square displacement of the vertices by each column over its range, `(column,)`, mm."""
        return self.gram.diagonal().sqrt()

    def columns_of(self, controls: Float[Tensor, "frame control"]) -> Float[Tensor, "frame column"]:
        """Controls `(frame, control)` as distances from neutral in fractions of the ranges, merged: `(frame, column)`."""
        return (controls.detach().cpu().double() - self.neutral) / self.span @ self.merge


def _poses(rig: RigBackend) -> Tensor:
    """Neutral, sparse poses, and poses of all controls at once: some act with others alone, some otherwise below neutral."""
    lower, upper, neutral = rig.lower.cpu(), rig.upper.cpu(), rig.neutral_controls.cpu()
    generator, active = generator_at(SEED, "control effects"), min(MAX_ACTIVE, len(rig.controls))
    sparse = sparse_controls(lower, upper, neutral, active, POSES, generator)
    dense = uniform(lower, upper, POSES // 2, generator)
    dense = torch.lerp(neutral, torch.cat([dense, lower + upper - dense]), 0.6)
    return torch.cat([neutral[None], sparse, dense]).to(rig.lower)


def _grams(rig: RigBackend) -> Tensor:
    """Inner products `(pose, control, control)`, mm^2, of the displacements by controls over their ranges, over vertices."""
    poses, span, count = _poses(rig), rig.upper - rig.lower, len(rig.rest_vertices)
    if isinstance(rig, LinearRig) and len(rig.basis) <= MAX_COEFFICIENTS:
        shapes = rig.basis.flatten(1)
        jacobian = finite_differences(rig.coefficients, poses, rig.lower, rig.upper)[1].scaled(span)
        return jacobian.gram(shapes @ shapes.T).cpu().double() / count
    found = []
    for pose in poses.split(1):
        jacobian = finite_differences(lambda controls: rig(controls).flatten(1), pose, rig.lower, rig.upper)[1]
        displacements = jacobian.scaled(span).dense()[0]
        found.append((displacements.T @ displacements).cpu().double() / count)
    return torch.stack(found)


def _groups(grams: Tensor, sizes: Tensor, moves: Tensor) -> list[list[int]]:
    """The controls that move the mesh, those with parallel displacements in every pose together."""
    cosines = grams.abs() / (sizes[:, :, None] * sizes[:, None, :]).clamp_min(1e-12)
    both, neither = moves[:, :, None] & moves[:, None, :], ~moves[:, :, None] & ~moves[:, None, :]
    same = ((both & (cosines > SAME_COSINE)) | neither).all(dim=0) & both.any(dim=0)
    groups: list[list[int]] = []
    for control in moves.any(dim=0).nonzero()[:, 0].tolist():
        twin = next((group for group in groups if bool(same[group[0], control])), None)
        groups.append([control]) if twin is None else twin.append(control)
    return groups
