"""Scans beside the recovered mesh, with distances both ways, for the page and the contact sheet."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.geometry.kinematics import remove_motion
from riginv.rig.interface import RigBackend
from riginv.tracking.markers.views import RigWithMarkers, with_balls
from riginv.tracking.surfaces.assembly import ScanParts
from riginv.tracking.surfaces.limited_cache import LimitedCache
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.quality import DEGREES, SEEN_MM
from riginv.tracking.surfaces.tracking import ScanTrack
from riginv.tracking.surfaces.triangles import Surface, TriangleMesh
from riginv.tracking.viewer.scans import DrawnScan, Scans

MAX_NUMBERS = 20_000_000  # of the matched scans together: some 120 MB


class ScanViews:
    """The scans of an inversion without their rigid motion, and the distances between them and the rig.

    Args:
        rig: that is shown.

    Attributes:
        rig: the same, with balls around its landmarks, if there are any.
    """

    def __init__(self, parts: ScanParts, track: ScanTrack, rig: RigBackend) -> None:
        self.parts, self.track, self.rig, self.skin = parts, track, rig, len(rig.rest_vertices)
        if parts.landmarks is not None:
            self.rig = RigWithMarkers(rig, parts.landmarks.placement)
            points = torch.from_numpy(parts.landmarks.points[parts.rows]).float()
            observed = torch.where(track.landmark_mm.isnan()[..., None], torch.nan, points)
            self.observed = remove_motion(track.motion, observed)
        self.outer = np.flatnonzero(parts.solver.surface.outer)
        # asked for by the page and by the contact sheet
        self.matched = LimitedCache(self._match, lambda matched: matched.size, MAX_NUMBERS)

    def surface(self, row: int) -> Surface | None:
        """The scan of a row; None where there is none."""
        parts, index = self.parts, self.parts.rows[row]
        cleaned = parts.scans.cleaned(index)
        if cleaned is None:
            return None
        motion = Motion.from_matrix(self.track.motion[row].double().numpy())
        axes, shift = motion.rotation.T @ parts.units.axes.double().numpy(), -motion.shift @ motion.rotation
        return cleaned.surface(parts.units.mm, axes, shift)

    def posed(self, row: int) -> TriangleMesh:
        """The recovered mesh of a row."""
        return self.parts.solver.surface.pose(self.track.controls[row]).mesh

    def nearest(self, wanted: Sequence[int]) -> Tensor:
        """The scan's points that are nearest to the rig's vertices, `(row, vertex, 3)`, mm; NaN where the scan sees none."""
        found = torch.stack([self.matched(row).nearest for row in wanted])
        if isinstance(self.rig, RigWithMarkers):
            return with_balls(found, self.observed[list(wanted)], self.rig.balls)
        return found

    @property
    def scans(self) -> Scans:
        """The scans with their distances from the rig, and their landmarks as balls."""
        return Scans(lambda row: self.matched(row).drawn, self.skin)

    def _match(self, row: int) -> "_Matched":
        scan = self.surface(row)
        found = torch.full((len(self.parts.solver.surface.outer), 3), torch.nan)
        if scan is None:
            return _Matched(found, None)
        mesh = self.posed(row)
        hits = scan.closest(mesh.points[self.outer])
        facing = (hits.normals * mesh.normals[self.outer]).sum(axis=1) > np.cos(np.radians(DEGREES))
        seen = facing & ~hits.on_border & (hits.distance < SEEN_MM)
        found[self.outer[seen]] = torch.from_numpy(hits.points[seen]).float()
        back = mesh.closest(scan.points)
        faces = scan.faces if isinstance(scan, TriangleMesh) else np.zeros((0, 3), np.int64)
        distance = np.where(back.on_border, np.nan, back.distance)
        drawn = DrawnScan(scan.points, scan.normals, faces, distance)
        if isinstance(self.rig, RigWithMarkers):
            known = ~self.track.landmark_mm[row].isnan()
            ball = self.rig.balls.double().cpu().numpy(), self.rig.ball_faces.cpu().numpy()
            drawn = drawn.with_balls(self.observed[row, known].numpy(), self.track.landmark_mm[row, known].numpy(), *ball)
        return _Matched(found, drawn)


class _Matched(NamedTuple):
    """A scan and a recovered mesh, matched both ways.

    Attributes:
        nearest: of the scan to the rig's vertices, `(vertex, 3)`.
        drawn: the scan with its distances; None where there is none.
    """

    nearest: Tensor
    drawn: DrawnScan | None

    @property
    def size(self) -> int:
        """How many numbers it holds, about."""
        return self.nearest.numel() + (0 if self.drawn is None else 7 * len(self.drawn.points) + 3 * len(self.drawn.faces))
