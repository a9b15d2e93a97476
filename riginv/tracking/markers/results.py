"""The results of an inversion of markers: residuals of frames and markers by the true rig, remarks, tables."""

from pathlib import Path

import torch
from torch import Tensor

from riginv.animation.animation import OUTSIDE_REACH, FrameErrors, MarkerErrors
from riginv.animation.table import write_rows
from riginv.errors import counted, listed
from riginv.geometry.kinematics import remove_motion
from riginv.rig.interface import RigBackend
from riginv.tracking.markers.placement import Placement
from riginv.tracking.markers.tracking import MarkerTrack
from riginv.tracking.options import FlagOptions

TABLE, RESIDUALS = "markers.csv", "marker_residuals.csv"
BATCH_SIZE = 64  # meshes
FEW = 0.5  # fraction of the markers below which a frame is flagged
POOR = 2.0  # times the median of the markers' means, from which a marker is named


@torch.no_grad()
def marker_errors(track: MarkerTrack, true_rig: RigBackend, numbers: Tensor, limits: FlagOptions) -> FrameErrors:
    """The distances of the used markers from those of the true rig, as frame errors."""
    observed = track.points if track.motion is None else remove_motion(track.motion, track.points)
    batches = zip(track.controls.split(BATCH_SIZE), observed.split(BATCH_SIZE))
    distance = torch.cat([(track.placement.points(true_rig(some)) - seen).norm(dim=2) for some, seen in batches])
    distance = torch.where(track.stray, torch.nan, distance)
    known = torch.isfinite(distance)
    mean = distance.nanmean(dim=1)
    most, marker = torch.where(known, distance, -1.0).max(dim=1)
    named = {
        "no_markers": ~track.known,
        "few_markers": track.known & (known.double().mean(dim=1) < FEW),
        "swapped_labels": track.swapped.any(dim=1),
        "stray_markers": track.stray.any(dim=1),
        OUTSIDE_REACH: track.known & (mean > limits.reach_mm),
    }
    rows = zip(*(flagged.tolist() for flagged in named.values()))
    flags = [[name for name, flagged in zip(named, row) if flagged] for row in rows]
    regions = [track.placement.names[index] for index in marker.tolist()]
    vertices = track.placement.corners[marker, track.placement.barycentric[marker].argmax(dim=1)]
    worst = torch.where(known.any(dim=1), most, torch.nan)
    return FrameErrors(mean, worst, vertices, regions, flags, numbers, markers=_each_marker(track, distance))


def _each_marker(track: MarkerTrack, distance: Tensor) -> tuple[MarkerErrors, ...]:
    seen = torch.isfinite(track.points).all(dim=2).double().mean(dim=0).tolist()
    counts = zip(track.swapped.sum(dim=0).tolist(), track.stray.sum(dim=0).tolist())
    whole = zip(each_marker(track.placement, distance), seen, counts)
    return tuple(errors._replace(seen=there, swapped=swapped, stray=stray) for errors, there, (swapped, stray) in whole)


def each_marker(placement: Placement, distance: Tensor) -> tuple[MarkerErrors, ...]:
    """The residuals of each marker from distances `(frame, marker)`, mm, NaN where it was not observed."""
    seen = distance.isfinite().double().mean(dim=0).tolist()
    columns = [column[torch.isfinite(column)] for column in distance.T]
    figures = [
        (float(one.mean()), float(one.quantile(0.95)), float(one.max())) if len(one) else (float("nan"),) * 3 for one in columns
    ]
    every = zip(placement.names, seen, figures, placement.offset_mm.tolist())
    return tuple(MarkerErrors(name, there, *three, offset, 0, 0) for name, there, three, offset in every)


def marker_remarks(errors: FrameErrors) -> list[str]:
    """Sentences for the user."""
    found = []
    means = torch.tensor([marker.mean_mm for marker in errors.markers])
    poor = [marker for marker in errors.markers if marker.mean_mm > POOR * float(means.nanmedian())]
    poor.sort(key=lambda marker: -marker.mean_mm)
    if poor:
        names = listed(f"{marker.name} ({marker.mean_mm:.2g} mm)" for marker in poor)
        found.append(f"markers that fit worst: {names}: is each where the map has it?")
    for word, counts in (("exchanged back", "swapped"), ("left out", "stray")):
        some = sorted((marker for marker in errors.markers if getattr(marker, counts)), key=lambda one: -getattr(one, counts))
        if some:
            names = listed(f"{marker.name} in {counted(getattr(marker, counts), 'frame')}" for marker in some)
            found.append(f"labels {word}: {names}")
    seen = sum(marker.seen for marker in errors.markers) / len(errors.markers)
    found.append(f"{seen:.0%} of the markers were observed; between them the mesh is the prior's guess: its error is not known")
    return found


def write_marker_tables(folder: Path, track: MarkerTrack, errors: FrameErrors, numbers: Tensor) -> list[str]:
    """Write markers.csv, a row for each marker, and marker_residuals.csv, a row for each frame; returns their names."""
    rows = [[marker.name, *(f"{value:.6g}" for value in marker[1:6]), *marker[6:]] for marker in errors.markers]
    header = ["marker", "seen", "mean_mm", "p95_mm", "max_mm", "offset_mm", "swapped_frames", "stray_frames"]
    write_rows(folder / TABLE, header, rows)
    cells = [["" if value != value else f"{value:.4g}" for value in row] for row in track.residual_mm.tolist()]
    body = [[number, *row] for number, row in zip(numbers.tolist(), cells)]
    write_rows(folder / RESIDUALS, ["frame", *track.placement.names], body)
    return [TABLE, RESIDUALS]
