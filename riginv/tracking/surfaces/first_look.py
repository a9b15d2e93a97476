"""A look at the first scan before any work starts: whether another unit fits, and whether its normals point inwards."""

from riginv.clips.options import ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.tracking.surfaces.alignment import GOOD_MM
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.scans import ScanSequence
from riginv.tracking.surfaces.solving import ScanSolver
from riginv.tracking.surfaces.triangles import Surface
from riginv.tracking.surfaces.units import first_scan, in_inches

BETTER = 0.8  # factor of the distance that another reading must reach


def checked_units(scans: ScanSequence, units: ClipUnits, reading: ReadingOptions, solver: ScanSolver) -> ClipUnits:
    """The units of a clip of scans, in inches where the first scan fits so and centimetres were only guessed.

    Half a face in centimetres is as large as a whole one in inches: the size alone does not tell them apart.

    Raises:
        InputError: the first scan fits the rig with its normals reversed only.
    """
    scan, axes = first_scan(scans), units.axes.double().numpy()

    def distance(surface: Surface) -> float:
        target = solver.target(surface)
        if not solver.moves:
            return solver.aligner.distance(target, Motion.identity())
        return solver.aligner.from_centre(target).distance_mm

    surface = scan.surface(units.mm, axes)
    as_read = distance(surface)
    inches = in_inches(units, reading, "the first scan fits the rig better so than in cm")
    if inches is not None and distance(scan.surface(inches.mm, axes)) < min(GOOD_MM, BETTER * as_read):
        return inches
    if as_read > GOOD_MM and distance(surface.reversed()) < min(GOOD_MM, BETTER * as_read):
        raise InputError(
            f"{scans.path}: the normals of its first scan point inwards: reversed it fits rig '{solver.rig.name}'; flip them "
            f"(the order of each face's corners), and export it again"
        )
    return units
