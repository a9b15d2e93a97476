"""Scans beside the recovered mesh, with distances both ways, for the page and the contact sheet."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from riginv.tracking.surfaces.assembly import ScanParts
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.quality import DEGREES, SEEN_MM
from riginv.tracking.surfaces.tracking import ScanTrack
from riginv.tracking.surfaces.triangles import Surface, TriangleMesh
from riginv.viewer.scans import DrawnScan


class ScanViews:
    """The scans of an inversion without their rigid motion, and the distances between them and the rig."""

    def __init__(self, parts: ScanParts, track: ScanTrack) -> None:
        self.parts, self.track = parts, track
        self.outer = np.flatnonzero(parts.solver.surface.outer)

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
        found = torch.full((len(wanted), len(self.parts.solver.surface.outer), 3), torch.nan)
        for place, row in enumerate(wanted):
            scan = self.surface(row)
            if scan is not None:
                mesh = self.posed(row)
                hits = scan.closest(mesh.points[self.outer])
                facing = (hits.normals * mesh.normals[self.outer]).sum(axis=1) > np.cos(np.radians(DEGREES))
                seen = facing & ~hits.on_border & (hits.distance < SEEN_MM)
                found[place, self.outer[seen]] = torch.from_numpy(hits.points[seen]).float()
        return found

    def drawn(self, row: int) -> DrawnScan | None:
        """The scan of a row, with its distances from the rig."""
        scan = self.surface(row)
        if scan is None:
            return None
        hits = self.posed(row).closest(scan.points)
        faces = scan.faces if isinstance(scan, TriangleMesh) else np.zeros((0, 3), np.int64)
        return DrawnScan(scan.points, scan.normals, faces, np.where(hits.on_border, np.nan, hits.distance))
