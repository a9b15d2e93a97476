"""Landmarks: named points of a rig's surface whose positions in a scan are known."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.tracking.markers.placement import Placement, point_derivatives
from riginv.tracking.surfaces.motion import Motion, fit_motion
from riginv.tracking.surfaces.rig_surface import RigSurface

FEWEST = 3  # landmarks that determine a rigid motion
THIN = 0.05  # second singular value of points, relative to the first, below which they count as collinear
WIDE_MM, POWER = 20.0, 3  # the robust scale up to which the weight falls as this power of it


class LandmarkTerm(NamedTuple):
    """The squared distances of landmarks near a state: three residuals each, along the axes of the rig's frame.

    Attributes:
        rows: derivatives of the residuals by the rig's coefficients, `(3 landmark, coefficient)`.
        motion_rows: by rigid motion, as `Pairs.motion_rows`, `(3 landmark, 6)`.
        residual: from the observed landmarks to the rig's, `(3 landmark,)`, mm.
        weights: `(3 landmark,)`; they sum to three times the weight of the mean squared distance.
    """

    rows: Tensor
    motion_rows: np.ndarray
    residual: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True)
class Landmarks:
    """The landmarks that were observed in one scan.

    Attributes:
        placement: on the rig's surface.
        points: observed, `(landmark, 3)`, mm, in the scan's frame.
        weight: of their mean squared distance at a robust scale of `WIDE_MM`, relative to that of the surface.
    """

    placement: Placement
    points: np.ndarray
    weight: float = 1.0

    def on(self, vertices: np.ndarray) -> np.ndarray:
        """The landmarks `(landmark, 3)` on a mesh `(vertex, 3)`, mm."""
        return self.placement.points(torch.from_numpy(vertices)).double().numpy()

    def away_from(self, vertices: np.ndarray) -> str:
        """How far the landmarks lie from those of a mesh in the scan's frame `(vertex, 3)`, in words."""
        away = np.linalg.norm(self.on(vertices) - self.points, axis=1)
        farthest = f"{self.placement.names[away.argmax()]!r} {away.max():.3g} mm"
        return f"the landmarks lie {away.mean():.3g} mm from the mesh's, {farthest}"

    def motion(self, vertices: np.ndarray) -> Motion | None:
        """The rigid motion from a mesh to the scan in closed form; None for fewer than three landmarks, or collinear ones."""
        ours = self.on(vertices)
        return fit_motion(ours, self.points, np.ones(len(ours))) if spans_a_plane(self.points) and spans_a_plane(ours) else None

    def weight_at(self, scale_mm: float) -> float:
        """The weight of the mean squared distance at a robust scale of the surface's distances."""
        return self.weight * min(1.0, scale_mm / WIDE_MM) ** POWER

    def term(self, rig: RigSurface, vertices: np.ndarray, motion: Motion, scale_mm: float) -> LandmarkTerm:
        """The squared distances near a state.

        Args:
            vertices: of the rig at the state, `(vertex, 3)`.
            motion: from the rig's frame to the scan's.
            scale_mm: robust scale of the surface's distances.
        """
        where, ours = self.placement, self.on(vertices)
        corners = torch.from_numpy(vertices)[where.corners]
        values = point_derivatives(
            corners, where.barycentric.to(corners), where.offset_mm.to(corners)
        )  # (landmark, 3, corner, 3)
        rows = rig.point_rows(np.repeat(where.corners.numpy(), 3, axis=0), values.flatten(0, 1).numpy())
        arms, axes = np.repeat(ours - rig.centre, 3, axis=0), np.tile(np.eye(3), (len(ours), 1))
        weights = np.full(3 * len(ours), self.weight_at(scale_mm) / len(ours))
        residual = (ours - motion.undo(self.points)).reshape(-1)
        return LandmarkTerm(rows, np.concatenate([np.cross(arms, axes), axes], axis=1), residual, weights)


def spans_a_plane(points: np.ndarray) -> bool:
    """Whether points `(point, 3)` are at least three, and not on one line."""
    if len(points) < FEWEST:
        return False
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(sizes[1] > THIN * sizes[0])
