"""A look at the first scan before any work starts: whether another unit fits, and whether its normals point inwards."""

import numpy as np

from riginv.clips.options import UNITS, ReadingOptions
from riginv.clips.units import GUESSED, ClipUnits
from riginv.errors import InputError
from riginv.tracking.surfaces.alignment import GOOD_MM
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.scans import Scan, ScanSequence
from riginv.tracking.surfaces.solving import ScanSolver
from riginv.tracking.surfaces.units import first_scan

BETTER = 0.8  # factor of the distance that another reading must reach


def checked_units(scans: ScanSequence, units: ClipUnits, reading: ReadingOptions, solver: ScanSolver) -> ClipUnits:
    """The units of a clip of scans, in inches where the first scan fits so and centimetres were only guessed.

    Half a face in centimetres is as large as a whole one in inches: the size alone does not tell them apart.

    Raises:
        InputError: the first scan fits the rig with its normals reversed only.
    """
    scan, axes = first_scan(scans), units.axes.double().numpy()

    def distance(mm: float, scan: Scan) -> float:
        target = solver.target(scan.surface(mm, axes))
        if not solver.moves:
            return solver.aligner.distance(target, Motion.identity())
        return solver.aligner.from_centre(target).distance_mm

    as_read = distance(units.mm, scan)
    if units.unit_source == GUESSED and np.isclose(units.mm, UNITS["cm"] * reading.scale):
        mm = UNITS["inch"] * reading.scale
        if distance(mm, scan) < min(GOOD_MM, BETTER * as_read):
            note = "units of inches guessed: the first scan fits the rig better so than in cm (reading.unit=cm)"
            return units._replace(mm=mm, notes=[note, *(other for other in units.notes if not other.startswith("units of cm"))])
    if as_read > GOOD_MM and distance(units.mm, scan.reversed()) < min(GOOD_MM, BETTER * as_read):
        raise InputError(
            f"{scans.path}: the normals of its first scan point inwards: reversed it fits rig '{solver.rig.name}'; flip them "
            f"(the order of each face's corners), and export it again"
        )
    return units
