"""Correspondences between a rig and a scan: closest points in both directions, with robust weights."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.tracking.surfaces.landmarks import Landmarks, LandmarkTerm
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.rig_surface import Posed, RigSurface
from riginv.tracking.surfaces.triangles import Hits, Surface

FROM_RIG = 0.15  # fraction of the weight for pairs from the rig to the scan: closest points of a noisy scan are biased


class Pairs(NamedTuple):
    """Pairs of points in the rig's frame, i.e. without rigid motion.

    Attributes:
        from_rig: number of pairs, the first ones, from samples of the rig to the scan.
        corners, barycentric: points of the rig as vertex indices and weights, `(pair, 3)`.
        points: of the rig, `(pair, 3)`, mm.
        normals: along which distances are measured, `(pair, 3)`.
        residual: signed distance along the normal, `(pair,)`, mm.
        distance: of the two points, `(pair,)`, mm.
        weights: `(pair,)`; they would sum to 1 if all pairs were good.
        on_border: whether the closest point lies on a border, `(pair,)`.
    """

    from_rig: int
    corners: np.ndarray
    barycentric: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    residual: np.ndarray
    distance: np.ndarray
    weights: np.ndarray
    on_border: np.ndarray

    def rows(self, rig: RigSurface) -> Tensor:
        """Derivatives of the rig's points along the normals by the coefficients, `(pair, coefficient)`."""
        return rig.rows(self.corners, self.barycentric, self.normals)

    @property
    def typical_mm(self) -> float:
        """Robust standard deviation of the distances of good pairs along the normals."""
        good = self.weights > 0
        return 1.4826 * float(np.median(np.abs(self.residual[good]))) if good.any() else 0.0

    def motion_rows(self, centre: np.ndarray) -> np.ndarray:
        """The same derivatives by a rigid motion, `(pair, 6)`: rotation about `centre`, radians, then translation, mm."""
        return np.concatenate([np.cross(self.points - centre, self.normals), self.normals], axis=1)


@dataclass(frozen=True)
class Target:
    """A scan with samples, as the target of a fit.

    Attributes:
        surface: the scan.
        points, normals: of the samples, `(sample, 3)`.
        landmarks: that were observed in it; None: none.
    """

    surface: Surface
    points: np.ndarray
    normals: np.ndarray
    landmarks: Landmarks | None = None

    @classmethod
    def of(cls, surface: Surface, samples: int, seed: int = 0, landmarks: Landmarks | None = None) -> "Target":
        return cls(surface, *surface.samples(samples, seed), landmarks)

    def landmark_term(self, rig: RigSurface, posed: Posed, motion: Motion, scale_mm: float) -> LandmarkTerm | None:
        """The squared distances of the landmarks near a pose, as `Landmarks.term`; None where there are none."""
        return None if self.landmarks is None else self.landmarks.term(rig, posed.mesh.points, motion, scale_mm)


def match(rig: RigSurface, posed: Posed, target: Target, motion: Motion, scale_mm: float, degrees: float) -> Pairs:
    """Closest points in both directions.

    Pairs whose normals differ by more than `degrees`, or whose closest point is on a border, have weight 0; the others have
    the weights of Geman and McClure.

    Args:
        motion: from the rig's frame to the scan's.
        scale_mm: the distance at which the weight is a quarter.
    """
    mesh, sampled = posed.mesh, rig.sampled
    start, normals = mesh.points[sampled], mesh.normals[sampled]
    hits = target.surface.closest(motion.apply(start))
    there = Hits(motion.undo(hits.points), motion.undo_direction(hits.normals), *hits[2:])
    corners = np.repeat(sampled[:, None], 3, axis=1)
    first_corner = np.zeros((len(sampled), 3))
    first_corner[:, 0] = 1
    from_rig = _pairs(start, normals, there.points, there.normals, there, scale_mm, degrees, corners, first_corner)
    points, towards = motion.undo(target.points), motion.undo_direction(target.normals)
    here = mesh.closest(points)
    from_scan = _pairs(here.points, here.normals, points, towards, here, scale_mm, degrees, here.corners, here.barycentric)
    fractions = np.repeat([FROM_RIG, 1 - FROM_RIG], [len(sampled), len(target.points)])
    joined = Pairs(len(sampled), *(np.concatenate(both) for both in zip(from_rig, from_scan)))
    return joined._replace(weights=joined.weights * fractions / fractions.sum())


def _pairs(
    ours: np.ndarray,
    our_normals: np.ndarray,
    theirs: np.ndarray,
    their_normals: np.ndarray,
    hits: Hits,
    scale_mm: float,
    degrees: float,
    corners: np.ndarray,
    weights: np.ndarray,
) -> list[np.ndarray]:
    """The arrays of `Pairs`."""
    cosine = (our_normals * their_normals).sum(axis=1)
    good = (cosine > np.cos(np.radians(degrees))) & ~hits.on_border
    residual = ((ours - theirs) * our_normals).sum(axis=1)  # the normals of a scan are noisy
    robust = 1 / (1 + (hits.distance / scale_mm) ** 2) ** 2
    robust = np.where(good, robust, 0.0)
    return [corners, weights, ours, our_normals, residual, hits.distance, robust, hits.on_border]


def as_tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
