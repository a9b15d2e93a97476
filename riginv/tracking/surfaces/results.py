"""The results of an inversion of scans: errors, remarks, scans.csv."""

from pathlib import Path

import torch

from riginv.animation.animation import FrameErrors
from riginv.animation.table import write_rows
from riginv.errors import listed
from riginv.tracking.surfaces.tracking import ScanTrack

TABLE = "scans.csv"


def frame_errors(track: ScanTrack, numbers: torch.Tensor) -> FrameErrors:
    """Mean distances of each scan's points from the rig, and of the rig's seen skin from the scan, as frame errors."""
    zero = torch.zeros(len(numbers), dtype=torch.long)
    return FrameErrors(track.scan_mm, track.rig_mm, zero, [""] * len(numbers), track.flags, numbers)


def remarks_of(track: ScanTrack) -> list[str]:
    """Sentences for the user."""
    found = list(track.notes)
    if track.open_controls:
        found.append(f"the scans do not determine {listed(track.open_controls)}: they stay where the prior has them")
    seen = float(track.seen.nanmedian())
    found.append(f"the scans see {seen:.0%} of the rig's skin; truth is not known: distances are those of the two surfaces")
    return found


def write_scan_table(folder: Path, track: ScanTrack, numbers: torch.Tensor) -> list[str]:
    """Write scans.csv, a row of distances, fractions and flags for each scan; returns its name."""
    columns = (numbers, track.scan_mm, track.rig_mm, track.seen, track.explained)
    rows = [
        [*(f"{value:.6g}" for value in row), " ".join(flags)]
        for *row, flags in zip(*(column.tolist() for column in columns), track.flags)
    ]
    header = ["frame", "scan_to_rig_mm", "rig_to_scan_mm", "rig_seen", "scan_explained", "flags"]
    write_rows(folder / TABLE, header, rows)
    return [TABLE]
