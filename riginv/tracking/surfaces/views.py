"""The page and the contact sheet of an inversion of scans: scans beside the recovered mesh, distances both ways."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from riginv.animation.animation import Animation, FrameErrors
from riginv.clips.description import ClipDescription
from riginv.clips.description_text import in_short, rows
from riginv.tracking.options import LookOptions
from riginv.tracking.results import PAGE, SHEET
from riginv.tracking.surfaces.assembly import ScanParts
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.quality import DEGREES, SEEN_MM
from riginv.tracking.surfaces.tracking import ScanTrack
from riginv.tracking.surfaces.triangles import Surface, TriangleMesh
from riginv.viewer.page import ClipSource, write_viewer
from riginv.viewer.scans import DrawnScan
from riginv.viewer.sheet import write_sheet
from riginv.viewer.tensorboard import write_tensorboard


class ScanViews:
    """The scans of an inversion without their rigid motion, and the distances between them and the rig."""

    def __init__(self, parts: ScanParts, track: ScanTrack) -> None:
        self.parts, self.track = parts, track
        self.outer = np.flatnonzero(parts.solver.surface.outer)

    def surface(self, row: int) -> Surface | None:
        """The scan of a row; None where there is none."""
        parts, index = self.parts, self.parts.rows[row]
        scan = parts.scans.scan(index) if index >= 0 else None
        cleaned = None if scan is None else scan.cleaned()
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


def write_scan_views(
    folder: Path,
    views: ScanViews,
    animation: Animation,
    errors: FrameErrors,
    look: LookOptions,
    clip: ClipDescription,
    advance: Callable[[str, int], None],
) -> tuple[list[str], list[str]]:
    """Write the page, the contact sheet and TensorBoard events into a folder; the names of the files, and notes.

    Args:
        animation: of a rig with the actor's neutral, if there is an actor.
    """
    names: list[str] = []
    notes: list[str] = []
    if look.page:
        advance("page", 0)
        source = ClipSource(in_short(clip), rows(clip, None), clip.warnings, clip.notes)
        page = write_viewer(folder / PAGE, animation, errors, views.nearest, clip=source, scans=views.drawn)
        notes.append(f"{PAGE}: {page.note}")
        names.append(PAGE)
    if look.sheet:
        write_sheet(folder / SHEET, animation, errors, views.nearest, views.drawn)
        names.append(SHEET)
    if look.tensorboard:
        write_tensorboard(folder, animation, errors, folder / SHEET if look.sheet else None)
    return names, notes
