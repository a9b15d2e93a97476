"""The choice between two kinds of inversion: by the rig's own vertices, and by surfaces of any topology."""

from pathlib import Path

from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.topology import TopologyError, check_topology
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.tracking.options import TrackingOptions
from riginv.tracking.surfaces.scan_files import is_ragged


def by_surface(
    path: str, options: TrackingOptions, rig: RigBackend, reading: ReadingOptions, has_network: bool
) -> tuple[bool, list[str]]:
    """Whether a clip is inverted by its surface, and notes for the user.

    Raises:
        InputError: the file cannot be read, or has the rig's vertices in another order.
    """
    if options.correspondence != "auto" or has_network or reading.vertices is not None or Path(path).suffix == ".csv":
        return options.correspondence == "surface", []
    if is_ragged(path):
        return True, ["scans of their own topology: fitted by their surface (correspondence=surface)"]
    try:
        check_topology(open_sequence(path, rig, reading), rig, reading.check_faces)
    except TopologyError as error:
        if error.same_count:  # the vertices are in another order, which the user must correct
            raise InputError(f"{error}, and correspondence=surface fits its surface") from None
        reason = str(error).partition(": ")[2].partition(": ")[0]
        return True, [f"{reason}: fitted by its surface (correspondence=vertices refuses such clips)"]
    return False, ["vertices in the rig's own order taken (correspondence=surface fits any mesh by its surface)"]
