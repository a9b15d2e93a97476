"""Units of scans, which may show part of the rig, or more than it."""

import numpy as np

from riginv.clips.options import UNITS, ReadingOptions
from riginv.clips.units import GUESSED, ClipUnits, SizeLimits, units_from_size
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.tracking.surfaces.scans import Scan, ScanSequence

LIMITS = SizeLimits(("mm", "cm", "m"), 3.0, 3.0)  # wide enough for half a face and for a whole head
AS_LARGE = 0.15  # difference of two sizes that are the same
NOTE = "units of"  # the beginning of the note on a guessed unit
SAMPLED_FRAMES = 20  # at most, to find one with enough points


def resolve_scan_units(scans: ScanSequence, rig: RigBackend, reading: ReadingOptions) -> ClipUnits:
    """The units of a clip of scans, see `riginv.clips.units.resolve_units`.

    Raises:
        InputError: no frame has enough points, or the scans would be absurdly small or large beside the rig.
    """
    rig_mm = robust_size(rig.rest_vertices.cpu().numpy())
    return units_from_size(scans, robust_size(first_scan(scans).points), rig_mm, rig.name, reading, LIMITS)


def resolve_neutral_units(scans: ScanSequence, rig: RigBackend, reading: ReadingOptions) -> ClipUnits:
    """The units of a scan of a whole neutral face, which is too small in centimetres if it is the rig's size in inches.

    Raises:
        InputError: as `resolve_scan_units`.
    """
    units = resolve_scan_units(scans, rig, reading)
    inches = in_inches(units, reading, "the scan is as large as the rig so")
    rig_mm = robust_size(rig.rest_vertices.cpu().numpy())
    is_as_large = inches is not None and abs(robust_size(first_scan(scans).points) * inches.mm / rig_mm - 1) < AS_LARGE
    return inches if inches is not None and is_as_large else units


def in_inches(units: ClipUnits, reading: ReadingOptions, why: str) -> ClipUnits | None:
    """Units in inches in place of guessed centimetres; None where these were not guessed."""
    if units.unit_source != GUESSED or not np.isclose(units.mm, UNITS["cm"] * reading.scale):
        return None
    notes = [note for note in units.notes if not note.startswith(f"{NOTE} cm")]
    return units._replace(mm=UNITS["inch"] * reading.scale, notes=[f"{NOTE} inches guessed: {why} (reading.unit=cm)", *notes])


def robust_size(points: np.ndarray) -> float:
    """Twice the root median square distance of points `(point, 3)` from their median: a size that ignores outliers."""
    middle = np.median(points, axis=0)
    return 2 * float(np.sqrt(np.median(((points - middle) ** 2).sum(axis=1))))


def first_scan(scans: ScanSequence) -> Scan:
    """The first scan of a clip, cleaned, among some frames spread over it.

    Raises:
        InputError: none has enough points.
    """
    for index in np.unique(np.linspace(0, len(scans) - 1, min(len(scans), SAMPLED_FRAMES)).astype(int)).tolist():
        cleaned = scans.cleaned(index)
        if cleaned is not None:
            return cleaned
    raise InputError(f"{scans.path}: no frame holds a scan of 50 points or more: there is nothing to fit")
