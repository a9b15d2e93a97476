"""The results of an inversion of scans: errors, remarks, scans.csv."""

from collections.abc import Sequence
from pathlib import Path

import torch

from riginv.animation.animation import FrameErrors
from riginv.animation.table import write_rows
from riginv.errors import listed
from riginv.tracking.markers.results import each_marker
from riginv.tracking.surfaces.tracking import FAR_MM, ScanTrack

TABLE = "scans.csv"


def frame_errors(track: ScanTrack, numbers: torch.Tensor) -> FrameErrors:
    """Mean distances of each scan's points from the rig, and of the rig's seen skin from the scan, as frame errors."""
    zero = torch.zeros(len(numbers), dtype=torch.long)
    landmarks = () if track.landmarks is None else each_marker(track.landmarks, track.landmark_mm)
    return FrameErrors(track.scan_mm, track.rig_mm, zero, [""] * len(numbers), track.flags, numbers, markers=landmarks)


def remarks_of(track: ScanTrack) -> list[str]:
    """Sentences for the user."""
    found = list(track.notes)
    if track.open_controls:
        found.append(f"the scans do not determine {listed(track.open_controls)}: they stay where the prior has them")
    if track.landmarks is not None:
        found.append(_on_landmarks(track.landmarks.names, track.landmark_mm))
    seen = float(track.seen.nanmedian())
    found.append(f"the scans see {seen:.0%} of the rig's skin; truth is not known: distances are those of the two surfaces")
    return found


def _on_landmarks(names: Sequence[str], distance: torch.Tensor) -> str:
    """A sentence on the distances of landmarks `(frame, landmark)`, mm."""
    mean = distance.nanmean(dim=0)
    worst = int(mean.nan_to_num(-1.0).argmax())
    text = f"the landmarks lie {float(distance.nanmean()):.2g} mm from the rig's on average"
    text += f", '{names[worst]}' {float(mean[worst]):.2g} mm"
    far = int((distance > FAR_MM).sum())
    return text + (
        f"; {far} of {int(distance.isfinite().sum())} by more than {FAR_MM:g} mm: is each where the map has it?" if far else ""
    )


def write_scan_table(folder: Path, track: ScanTrack, numbers: torch.Tensor) -> list[str]:
    """Write scans.csv, a row of distances, fractions and flags for each scan; returns its name."""
    columns = [numbers, track.scan_mm, track.rig_mm, track.seen, track.explained]
    header = ["frame", "scan_to_rig_mm", "rig_to_scan_mm", "rig_seen", "scan_explained"]
    if track.landmarks is not None:
        columns.append(track.landmark_mm.nanmean(dim=1))
        header.append("landmarks_mm")
    rows = [
        [*(f"{value:.6g}" for value in row), " ".join(flags)]
        for *row, flags in zip(*(column.tolist() for column in columns), track.flags)
    ]
    write_rows(folder / TABLE, [*header, "flags"], rows)
    return [TABLE]
