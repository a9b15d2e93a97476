"""Pairs of points of a rig and of a scan, both ways, with the weights that tell good pairs from bad ones."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.rig_surface import Posed, RigSurface
from riginv.tracking.surfaces.triangles import Hits, Surface

FROM_RIG = 0.15  # of the weight of all pairs, for those from the rig to the scan: closest points of a noisy scan are biased


class Pairs(NamedTuple):
    """Pairs of points, in the rig's frame (before rigid motion).

    Attributes:
        corners, barycentric: the point of the rig, `(pair, 3)`.
        points: of the rig, `(pair, 3)`, mm.
        normals: along which the distance counts, `(pair, 3)`.
        residual: signed distance along the normal, `(pair,)`, mm.
        distance: of the two points, `(pair,)`, mm.
        weights: `(pair,)`; those of all pairs, good or bad, would sum up to 1 if all were good.
        on_border: whether the closest point lies on a border, `(pair,)`.
        from_rig: how many of them, counted from the first, are closest points of the scan to samples of the rig.
    """

    corners: np.ndarray
    barycentric: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    residual: np.ndarray
    distance: np.ndarray
    weights: np.ndarray
    on_border: np.ndarray
    from_rig: int

    def rows(self, rig: RigSurface) -> Tensor:
        """How far each coefficient moves the rig's points along the normals, `(pair, coefficient)`."""
        return rig.rows(self.corners, self.barycentric, self.normals)

    @property
    def typical_mm(self) -> float:
        """Standard deviation of the good pairs' distances along the normals, robustly."""
        good = self.weights > 0
        return 1.4826 * float(np.median(np.abs(self.residual[good]))) if good.any() else 0.0

    def motion_rows(self, centre: np.ndarray) -> np.ndarray:
        """The same of the six parameters of a rigid motion, `(pair, 6)`: radians about `centre`, then mm."""
        return np.concatenate([np.cross(self.points - centre, self.normals), self.normals], axis=1)


@dataclass(frozen=True)
class Target:
    """A scan that is to be met, prepared once.

    Attributes:
        surface: the scan.
        points, normals: samples of it `(sample, 3)`.
    """

    surface: Surface
    points: np.ndarray
    normals: np.ndarray

    @classmethod
    def of(cls, surface: Surface, samples: int, seed: int = 0) -> "Target":
        return cls(surface, *surface.samples(samples, seed))


def match(rig: RigSurface, posed: Posed, target: Target, motion: Motion, scale_mm: float, degrees: float) -> Pairs:
    """Closest points both ways.

    Pairs whose normals differ by more than `degrees`, or whose closest point lies on a border, count nothing; the others by
    the weights of Geman and McClure at a scale.

    Args:
        motion: from the rig's frame to the scan's.
        scale_mm: the distance at which a pair counts a quarter.
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
    joined = [np.concatenate(both) for both in zip(from_rig, from_scan)]
    shares = np.repeat([FROM_RIG, 1 - FROM_RIG], [len(sampled), len(target.points)])
    joined[6] = joined[6] * shares / shares.sum()
    return Pairs(*joined, from_rig=len(sampled))


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
) -> tuple[np.ndarray, ...]:
    alike = (our_normals * their_normals).sum(axis=1)
    good = (alike > np.cos(np.radians(degrees))) & ~hits.on_border
    residual = ((ours - theirs) * our_normals).sum(axis=1)  # those of a scan carry its noise
    robust = 1 / (1 + (hits.distance / scale_mm) ** 2) ** 2
    return corners, weights, ours, our_normals, residual, hits.distance, np.where(good, robust, 0.0), hits.on_border


def as_tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
