"""What the numbers of scans mean: the unit by their size beside the rig, wide enough for scans of part of it, or of more."""

import math

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.units import AS_GIVEN, AS_THE_FILE_SAYS, DEFAULT_FPS, GUESSED_SOURCE, TO_Y_UP, UNITS, ClipUnits
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.tracking.surfaces.scans import ScanSequence

GUESSED = ("mm", "cm", "m")  # a factor of ten and more apart, so that scans of half a face or of a whole head still tell them
FITS = 3.0  # times the rig's size that a scan may be, either way
LOOKED_AT = 20  # frames, at most, that are looked at for one with enough points


def resolve_scan_units(scans: ScanSequence, rig: RigBackend, reading: ReadingOptions) -> ClipUnits:
    """Millimetres to a unit, axes and rate of a clip of scans.

    Raises:
        InputError: no frame has enough points, or the scans would be absurdly small or large beside the rig.
    """
    notes: list[str] = []
    rig_mm, found = size_of(rig.rest_vertices.cpu().numpy()), _size_of_scans(scans)
    mm = _unit(scans, reading.unit, found * reading.scale, rig_mm, rig.name, notes) * reading.scale
    up = scans.up or "y" if reading.up == "auto" else reading.up
    if up not in TO_Y_UP:
        raise InputError(f"reading.up is {reading.up!r}, expected auto, x, y or z")
    fps = reading.fps or scans.fps or DEFAULT_FPS
    if not (reading.fps or scans.fps):
        notes.append(f"{DEFAULT_FPS:g} frames a second taken, because the files do not say (reading.fps=...)")
    if not 0 < fps < 1e6:
        raise InputError(f"reading.fps is {fps!r}, expected frames a second, a number above 0")
    return ClipUnits(
        mm,
        TO_Y_UP[up],
        float(fps),
        notes,
        unit_source=AS_THE_FILE_SAYS if reading.unit == "auto" and scans.unit_mm else _source(reading.unit != "auto"),
        up=up,
        up_source=AS_THE_FILE_SAYS if reading.up == "auto" and scans.up else _source(reading.up != "auto"),
        rate_source=AS_THE_FILE_SAYS if not reading.fps and scans.fps else _source(bool(reading.fps)),
    )


def _source(given: bool) -> str:
    return AS_GIVEN if given else GUESSED_SOURCE


def size_of(points: np.ndarray) -> float:
    """How far apart points `(point, 3)` lie: twice the root median square distance from their median, deaf to outliers."""
    middle = np.median(points, axis=0)
    return 2 * float(np.sqrt(np.median(((points - middle) ** 2).sum(axis=1))))


def _unit(scans: ScanSequence, unit: object, found: float, rig_mm: float, rig: str, notes: list[str]) -> float:
    if unit == "auto":
        options = {"the file's unit": scans.unit_mm} if scans.unit_mm else {name: UNITS[name] for name in GUESSED}
        best = min(options, key=lambda name: abs(math.log(max(found * options[name], 1e-30) / rig_mm)))
        mm = options[best]
    else:
        best = f"reading.unit={unit}"
        mm = UNITS.get(unit, 0.0) if isinstance(unit, str) else float(unit)
        if not mm > 0:
            raise InputError(
                f"reading.unit is {unit!r}, expected auto, {', '.join(UNITS)}, or millimetres to a unit as a number"
            )
    if not rig_mm / FITS < found * mm < rig_mm * FITS:
        raise InputError(
            f"{scans.path}: in {best} its scans measure {found * mm:.3g} mm, and rig '{rig}' {rig_mm:.3g} mm: give the unit "
            f"with reading.unit=mm, cm, m or millimetres to a unit as a number; or these are scans of something else"
        )
    if unit == "auto":
        notes.append(f"units of {mm:g} mm taken: the scans measure {found * mm:.3g} mm so, rig '{rig}' {rig_mm:.3g} mm")
    return mm


def _size_of_scans(scans: ScanSequence) -> float:
    for number in np.unique(np.linspace(0, len(scans) - 1, min(len(scans), LOOKED_AT)).astype(int)):
        scan = scans.scan(int(number))
        cleaned = None if scan is None else scan.cleaned()
        if cleaned is not None:
            return size_of(cleaned.points)
    raise InputError(f"{scans.path}: no frame holds a scan of 50 points or more: there is nothing to fit")
