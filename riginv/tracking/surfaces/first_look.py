"""A look at the first scan before any work starts: whether another unit fits, and whether its normals point inwards."""

from riginv.clips.options import ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.tracking.surfaces.alignment import BETTER, FAIR_MM, Alignment
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.motion import Motion
from riginv.tracking.surfaces.scans import ScanSequence
from riginv.tracking.surfaces.solving import ScanSolver
from riginv.tracking.surfaces.units import first_scan, in_inches, robust_size


def checked_units(scans: ScanSequence, units: ClipUnits, reading: ReadingOptions, solver: ScanSolver) -> ClipUnits:
    """The units of a clip of scans, in inches where the first scan fits so and centimetres were only guessed.

    Half a face in centimetres is as large as a whole one in inches: the size alone does not tell them apart. A scan that is
    read too small lies nearer to the rig; so distances are compared relative to its size.

    Raises:
        InputError: the first scan fits the rig with its normals reversed only.
    """
    scan, axes, aligner = first_scan(scans), units.axes.double().numpy(), solver.aligner

    def look(mm: float, is_likely: bool) -> tuple[Target, Alignment]:
        target = solver.target(scan.surface(mm, axes))
        if not solver.moves:
            return target, Alignment(Motion.identity(), aligner.distance(target, Motion.identity()), False)
        return target, aligner.align(target) if is_likely else aligner.from_centre(target)  # the former may take seconds

    target, as_read = look(units.mm, True)
    inches = in_inches(units, reading, "the first scan fits the rig better so than in cm")
    if inches is not None:
        larger, rig_mm = inches.mm / units.mm, robust_size(solver.rig.rest_vertices.cpu().numpy())
        is_small = units.mm * robust_size(scan.points) * larger**0.5 < rig_mm  # its size in inches is nearer to the rig's
        distance = look(inches.mm, is_small)[1].distance_mm
        if distance < min(FAIR_MM, BETTER * larger * as_read.distance_mm):
            return inches
    aligner.refuse_inwards(target, as_read, f"{scans.path}: the normals of its first scan")
    return units
