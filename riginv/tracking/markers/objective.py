"""The objective of the solvers for markers: the squared distance of the known markers, rigid motion eliminated, plus priors.

Rigid motion takes its optimum for any controls (variable projection, Golub and Pereyra, 1973): the solvers see controls alone.
"""

import copy
from typing import NamedTuple

import roma
import torch
from torch import Tensor

from riginv.rig.interface import LinearRig
from riginv.rig.jacobian import Jacobian
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.objective import GaussianPrior, Linearised
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.markers.placement import Placement, point_derivatives, points_on
from riginv.tracking.penalties import ControlPenalties, PenalisedObjective

FEWEST = 4  # known markers of a frame that is solved


class MarkerRig(FixedControlsRig):
    """A rig with some controls fixed, reduced to the triangles that carry markers; its mesh is the points on these.

    Attributes:
        corners_rest, corners_basis: rest positions and basis of the triangles' corners, `(marker, corner, 3)` and
            `(coefficient, marker, corner, 3)`.
    """

    corners_rest: Tensor
    corners_basis: Tensor

    def __init__(self, rig: LinearRig, free: Tensor, values: Tensor, placement: Placement) -> None:
        super().__init__(rig, free, values)
        self.has_first_guess, self.gradient_steps = False, 0  # those of whole meshes
        self.register_buffer("corners_rest", rig.rest_vertices[placement.corners], persistent=False)
        self.register_buffer("corners_basis", rig.basis[:, placement.corners].contiguous(), persistent=False)
        weights = placement.barycentric[..., None]
        self.rest_vertices = (weights * self.corners_rest).sum(dim=1)
        self.basis = (weights * self.corners_basis).sum(dim=2)

    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        if len(self.free) == len(self.values):
            return self.rig.coefficient_jacobian(controls)  # the columns need no copy
        return super().coefficient_jacobian(controls)

    def features(self, coefficients: Tensor) -> Tensor | None:
        return None


def pack(points: Tensor, weights: Tensor | None = None) -> Tensor:
    """Observed markers `(frame, marker, 3)`, NaN where unknown, with weights `(frame, marker)` or 1, as `(frame, 4 marker)`.

    Frames with fewer than `FEWEST` known markers become NaN, which solvers skip.
    """
    weights = torch.where(torch.isfinite(points).all(dim=2), 1.0 if weights is None else weights, 0.0)
    packed = torch.cat([torch.where(weights[..., None] > 0, points, 0.0).flatten(1), weights], dim=1)
    packed[(weights > 0).sum(dim=1) < FEWEST] = torch.nan
    return packed


class Residuals(NamedTuple):
    """Markers of a batch of frames compared with those observed, in the rig's frame.

    Attributes:
        corners: of the markers' triangles, `(frame, marker, corner, 3)`.
        points: the rig's markers, `(frame, marker, 3)`.
        residual: from the observed markers to the rig's, `(frame, marker, 3)`; 0 where unknown.
        weights: `(frame, marker)`.
        motion: rotation `(frame, 3, 3)` and translation `(frame, 3)` from the rig's frame to the observed one.
    """

    corners: Tensor
    points: Tensor
    residual: Tensor
    weights: Tensor
    motion: tuple[Tensor, Tensor]


class MarkerObjective(PenalisedObjective):
    """The objective of packed markers (`pack`).

    Args:
        rig: over the free controls.
        placement: of the markers.
        moves: whether rigid motion is eliminated; else the markers are in the rig's frame.
        prior, sparsity, penalties, learned: as in `PenalisedObjective`.

    Attributes:
        changes: covariance of the controls' second differences, as `solve_clip` takes it; None: not known.
    """

    changes: Tensor | None = None

    def __init__(
        self,
        rig: MarkerRig,
        placement: Placement,
        moves: bool,
        prior: float,
        sparsity: float,
        penalties: ControlPenalties,
        learned: GaussianPrior | None,
    ) -> None:
        count = len(placement)
        space = MeshSpace(rig.rest_vertices, torch.eye(3 * count).to(rig.rest_vertices).unflatten(1, (count, 3)))
        super().__init__(RigInMeshSpace(rig, space), prior, sparsity, penalties, learned)
        self.all, self.placement, self.moves = rig.all_controls, placement, moves
        self.corners_rest, self.corners_basis = rig.corners_rest, rig.corners_basis

    def all_controls(self, units: Tensor) -> Tensor:
        """All controls, within the limits of the rig, of free controls as fractions of their ranges."""
        return self.all(self.to_controls(units))

    def at_offsets(self, offset_mm: Tensor) -> "MarkerObjective":
        """The same objective with other offsets `(marker,)` of the markers."""
        other = copy.copy(self)
        other.placement = self.placement.with_offsets(offset_mm)
        return other

    @torch.no_grad()
    def residuals(self, units: Tensor, packed: Tensor) -> Residuals:
        """The residuals at controls `(frame, control)`."""
        return self._residuals(self.rig.source.coefficients(self.lower + self.span * units), packed)

    def _residuals(self, coefficients: Tensor, packed: Tensor) -> Residuals:
        count = len(self.placement)
        target, weights = packed[:, : 3 * count].unflatten(1, (count, 3)), packed[:, 3 * count :]
        moved = (coefficients - self.rest) @ self.corners_basis.flatten(1)
        corners = self.corners_rest + moved.unflatten(1, (count, 3, 3))
        points = points_on(corners, self.placement.barycentric, self.placement.offset_mm)
        rotation, translation = torch.eye(3).to(points).expand(len(points), 3, 3), torch.zeros_like(points[:, 0])
        if self.moves:
            given = torch.where(weights.sum(dim=1, keepdim=True) > 0, weights, 1.0)
            rotation, translation = roma.rigid_points_registration(points, target, given)
            target = (target - translation[:, None]) @ rotation
        residual = torch.where(weights[..., None] > 0, points - target, 0.0)
        return Residuals(corners, points, residual, weights, (rotation, translation))

    @torch.no_grad()
    def cost(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Tensor:
        found = self.residuals(units, coordinates)
        distance = 0.5 * (found.weights * found.residual.square().sum(dim=2)).sum(dim=1)
        return (distance if weights is None else weights * distance) + self._prior(units)[0]

    @torch.no_grad()
    def gradient(self, units: Tensor, coordinates: Tensor) -> Tensor:
        return self.linearise(units, coordinates).gradient

    def derivatives(self, units: Tensor, packed: Tensor) -> "Derivatives":
        """The weighted residuals at controls `(frame, control)`, and their derivatives."""
        coefficients, jacobian = self.rig.source.coefficient_jacobian(self.lower + self.span * units)
        found = self._residuals(coefficients, packed)
        by_corners = point_derivatives(found.corners, self.placement.barycentric, self.placement.offset_mm)
        rows = torch.einsum("fmaij,kmij->fmak", by_corners, self.corners_basis).flatten(1, 2)
        columns = jacobian.times_each(rows) * self.span
        roots = found.weights.sqrt()[..., None]
        columns = roots.repeat(1, 1, 3).flatten(1)[..., None] * columns
        rigid = rigid_columns(found.points, roots) if self.moves else columns[..., :0]
        return Derivatives((roots * found.residual).flatten(1), columns, rigid, found)

    def _linearise_data(self, units: Tensor, coordinates: Tensor) -> Linearised:
        near = self.derivatives(units, coordinates)
        across = near.columns.mT @ near.rigid
        gradient = (near.columns.mT @ near.residual[..., None])[..., 0]
        hessian = near.columns.mT @ near.columns - across @ across.mT
        return Linearised(0.5 * near.residual.square().sum(dim=1), gradient, hessian)


class Derivatives(NamedTuple):
    """Residuals of a batch of frames with their derivatives, times the square roots of the weights.

    Attributes:
        residual: `(frame, 3 marker)`.
        columns: derivatives by the controls, `(frame, 3 marker, control)`.
        rigid: an orthonormal basis of the derivatives by rigid motion, `(frame, 3 marker, 6)`; without motion none.
        residuals: the same residuals, unweighted.
    """

    residual: Tensor
    columns: Tensor
    rigid: Tensor
    residuals: Residuals


def rigid_columns(points: Tensor, roots: Tensor) -> Tensor:
    """An orthonormal basis `(frame, 3 marker, 6)` of weighted displacements of points by small rigid motions.

    Args:
        points: `(frame, marker, 3)`.
        roots: square roots of the weights, `(frame, marker, 1)`.
    """
    weights = roots.square()
    centre = (weights * points).sum(dim=1, keepdim=True) / weights.sum(dim=1, keepdim=True).clamp_min(1e-12)
    away = points - centre
    size = (weights * away.square()).sum(dim=(1, 2), keepdim=True).clamp_min(1e-12).sqrt()
    axes = torch.eye(3).to(points)
    turned = torch.linalg.cross(axes[:, None, None], (away / size)[None], dim=-1)  # (axis, frame, marker, 3)
    shifted = axes[:, None, None].expand_as(turned) / weights.sum(dim=1)[None, :, None].clamp_min(1e-12).sqrt()
    columns = (roots * torch.cat([turned, shifted])).permute(1, 2, 3, 0).flatten(1, 2)
    gram = columns.mT @ columns + 1e-6 * torch.eye(6).to(points)
    return columns @ torch.linalg.inv(torch.linalg.cholesky(gram)).mT
