"""What a clip of scans holds, as table rows."""

import numpy as np

from riginv.clips.description import missing_frames, span_of
from riginv.clips.description_text import frames_text, unit_text
from riginv.clips.options import ReadingOptions
from riginv.clips.units import ClipUnits, resolve_units_without_rig
from riginv.errors import counted
from riginv.rig.interface import RigBackend
from riginv.rig.size import extent
from riginv.tracking.surfaces.scans import ScanSequence
from riginv.tracking.surfaces.units import in_inches, resolve_scan_units

SAMPLED_FRAMES = 24  # read at most


def scan_rows(scans: ScanSequence, reading: ReadingOptions, rig: RigBackend | None) -> tuple[list[tuple[str, str]], list[str]]:
    """The contents of a clip of scans as table rows (label, value), and notes.

    Args:
        rig: whose size tells the unit; None: the file's own.

    Raises:
        InputError: a frame is damaged, or no frame has enough points to guess the unit from.
    """
    units: ClipUnits = resolve_units_without_rig(scans, reading) if rig is None else resolve_scan_units(scans, rig, reading)
    frames = np.unique(np.linspace(0, len(scans) - 1, min(len(scans), SAMPLED_FRAMES)).astype(int)).tolist()
    read = {frame: scans.scan(frame) for frame in frames}
    known = {frame: scan.cleaned() for frame, scan in read.items() if scan is not None}
    used = [scan for scan in known.values() if scan is not None]
    empty = [str(int(scans.frame_numbers[frame])) for frame in frames if known.get(frame) is None]
    is_mesh = [scan.faces is not None for scan in used]
    normals = "of the faces" if all(is_mesh) else "none: estimated from 16 neighbours each, outwards"
    if not any(is_mesh) and all(scan.normals is not None for scan in used):
        normals = "in the file"
    size = np.ptp(units.mm * used[0].points @ units.axes.double().numpy().T, axis=0).tolist() if used else [0.0] * 3
    span, (missing, _) = span_of(scans.frame_numbers), missing_frames(scans.frame_numbers)
    looked = f" ({len(frames)} frames looked at)" if len(frames) < len(scans) else ""
    rows = [
        ("format", scans.facts.format),
        ("kind", "scans: " + ("meshes" if all(is_mesh) else "meshes and point clouds" if any(is_mesh) else "point clouds")),
        ("points", _range([len(scan.points) for scan in used]) + looked),
        ("faces", _range([len(scan.faces) for scan in used if scan.faces is not None])),
        ("normals", normals if used else ""),
        ("frames", frames_text(span) + (f" ({missing:,} missing)" if missing else "")),
        ("without a scan", f"{counted(len(empty), 'frame')}: {', '.join(empty)}" if empty else ""),
        ("rate", f"{units.fps:g} frames a second ({units.rate_source})"),
        ("size", extent(size, "" if units.unit_source else "units")),
        ("unit", unit_text(units.mm if units.unit_source else None, units.unit_source)),
        ("up", f"{units.up} ({units.up_source})"),
    ]
    notes = [*scans.facts.notes, *units.notes]
    if rig is not None and in_inches(units, reading, "") is not None:
        notes.append("it may be in inches, too: riginv.invert compares both on the first scan, and says which it takes")
    return [(name, text) for name, text in rows if text], notes


def _range(counts: list[int]) -> str:
    """The least and the greatest of some counts."""
    if not counts:
        return ""
    least, most = min(counts), max(counts)
    return f"{least:,} in each frame" if least == most else f"{least:,} to {most:,} a frame"
