"""The size of a rig, and a test of whether it is plausible: faces are about 200 mm tall, bodies about 2 m."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from riginv.errors import counted
from riginv.rig.interface import RigBackend
from riginv.runs.console import show_lines

LEAST_MM, LARGEST_MM = 50.0, 5000.0  # plausible lengths of a rig's longest side
FACES_MM, BODIES_MM = (100.0, 400.0), (500.0, 3000.0)
UNITS_MM = (1.0, 10.0, 100.0, 1000.0)  # common units of files


def rig_line(rig: RigBackend) -> str:
    """One line on a rig: its controls, its mesh and its size."""
    size = (rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).tolist()
    contents = f" ({rig.contents})" if rig.contents else ""
    return (
        f"rig {rig.name}: {counted(len(rig.controls), 'control')}{contents}, {len(rig.rest_vertices):,} vertices, "
        f"{len(rig.faces):,} faces, {length(size[1])} tall ({extent(size)})"
    )


def size_doubt(rig: RigBackend, unit_mm: float | None = None) -> str:
    """A warning where a rig's size is implausible, with a remedy; else empty.

    Args:
        unit_mm: the value of `rig.unit_mm`, where the rig has such a key.
    """
    longest = float((rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).max())
    if LEAST_MM <= longest <= LARGEST_MM:
        return ""
    remedy = "a rig's vertices must be in mm (rig.unit_mm, where the rig has it)"
    if unit_mm:
        remedy = f"now a unit of its file counts as {unit_mm:g} mm (rig.unit_mm){_units_that_fit(longest, unit_mm)}"
    return (
        f"rig '{rig.name}' measures {length(longest)}, and faces measure 100 to 400 mm, bodies 0.5 to 3 m: if that is wrong, "
        f"every error in mm is wrong, too; {remedy}"
    )


def _units_that_fit(longest: float, unit_mm: float) -> str:
    """The units in which a rig would have the size of a face or a body."""
    found = []
    for kind, (least, most) in (("face", FACES_MM), ("body", BODIES_MM)):
        for unit in UNITS_MM:
            if least <= longest / unit_mm * unit <= most and unit != unit_mm:
                found.append(f"{unit:g} makes it a {kind} of {length(longest / unit_mm * unit)}")
    return f": {', '.join(found)}" if found else ""


def length(mm: float) -> str:
    """A length in a readable unit: `174 mm`, `1.72 m`."""
    if not math.isfinite(mm):
        return "infinitely much"
    for unit, size in (("km", 1e6), ("m", 1e3)):
        if mm >= size:
            return f"{mm / size:.3g} {unit}"
    return f"{mm:.0f} mm" if mm >= 100 else f"{mm:.3g} mm"


def extent(sides: Sequence[float], unit: str = "") -> str:
    """The sides of a box, given in mm, as text: `97 x 174 x 90 mm`; with `unit`, given and written in that."""
    scale, unit = (1.0, unit) if unit else (1000.0, "m") if max(sides) >= 1000 else (1.0, "mm")
    return f"{' x '.join(f'{side / scale:.3g}' for side in sides)} {unit}"


def show_rig(rig: RigBackend, config: Mapping[str, Any] | None = None, console: Console | None = None) -> None:
    """Print a line on a rig, its notes, and a warning where its size is implausible.

    Args:
        config: the rig's config.
        console: None: standard error.
    """
    doubt = size_doubt(rig, (config or {}).get("unit_mm"))
    show_lines([rig_line(rig)], rig.notes, [doubt] if doubt else [], console)
