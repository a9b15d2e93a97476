"""What a clip's numbers mean: millimetres to a unit, which axis points up, frames a second; guessed only with a reason."""

import math
from typing import Any, NamedTuple

import numpy as np
import torch

from riginv.clips.sequence import MeshSequence
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.rig.size import length

UNITS = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0, "inch": 25.4, "foot": 304.8}
GUESSED = ("mm", "cm", "dm", "m", "inch")  # in this order where two fit alike
FITS = 1.25  # times the rig's size that a clip may be, either way, for a unit to be guessed
ABSURD = 4.0  # times the rig's size beyond which a unit that was given is called out
DEFAULT_FPS = 30.0
AS_GIVEN, AS_THE_FILE_SAYS, GUESSED_SOURCE = "as given", "as the file says", "guessed"  # where a value comes from
# Rotations that bring an axis up: the clip's x, y, z as rows of what they become.
TO_Y_UP = {
    "x": torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "y": torch.eye(3),
    "z": torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}


class ClipUnits(NamedTuple):
    """How a clip's numbers become millimetres, y up.

    Attributes:
        mm: to a unit of the clip.
        axes: `(3, 3)`: what turns a point of the clip upright.
        fps: frames a second.
        notes: what was guessed, and why.
        unit_source, up_source, rate_source: where these three come from, as a few words: `as the file says`. Without a unit
            (`unit_source` empty) mm is 1 and lengths are in the file's own unit.
        up: the axis of the file that points up.
    """

    mm: float
    axes: torch.Tensor
    fps: float
    notes: list[str]
    unit_source: str = AS_GIVEN
    up: str = "y"
    up_source: str = AS_GIVEN
    rate_source: str = AS_GIVEN


def resolve_units(clip: MeshSequence, rig: RigBackend, unit: Any, scale: Any, up: Any, fps: Any) -> ClipUnits:
    """What a clip's numbers mean.

    Args:
        unit: a key of UNITS, millimetres to a unit as a number, or `auto`.
        scale: a factor on top of that.
        up: `x`, `y`, `z` or `auto`.
        fps: frames a second, or None: what the file says.

    Raises:
        InputError: a value is none of these, or the clip would be absurdly small or large beside the rig.
    """
    _check_scale(scale)
    notes: list[str] = []
    found = _size_of_clip(clip)
    rig_mm = _size(rig.rest_vertices.cpu().numpy())
    mm, unit_source = _unit(clip, unit, found * scale, rig_mm, rig.name, notes)
    rate, rate_source = _fps(clip, fps, notes)
    axis, up_source = _up(clip, up, notes)
    return ClipUnits(mm * scale, TO_Y_UP[axis], rate, notes, unit_source, axis, up_source, rate_source)


def resolve_units_without_rig(clip: MeshSequence, unit: Any, scale: Any, up: Any, fps: Any) -> ClipUnits:
    """What a clip's numbers mean where there is no rig to compare its size with; arguments as for `resolve_units`.

    Raises:
        InputError: a value is none of these.
    """
    _check_scale(scale)
    notes: list[str] = []
    mm, unit_source = (clip.unit_mm or 1.0, AS_THE_FILE_SAYS if clip.unit_mm else "") if unit == "auto" else _given_unit(unit)
    rate, rate_source = _fps(clip, fps, notes)
    axis, up_source = _up(clip, up, notes)
    return ClipUnits(mm * scale, TO_Y_UP[axis], rate, notes, unit_source, axis, up_source, rate_source)


def _check_scale(scale: Any) -> None:
    if not _positive(scale):
        raise InputError(f"reading.scale is {scale!r}, expected a number above 0")


def _given_unit(unit: Any) -> tuple[float, str]:
    mm = UNITS.get(unit) if isinstance(unit, str) else unit
    if not _positive(mm):
        raise InputError(f"reading.unit is {unit!r}, expected auto, {', '.join(UNITS)}, or millimetres to a unit as a number")
    return mm, AS_GIVEN


def _unit(clip: MeshSequence, unit: Any, found: float, rig_mm: float, rig: str, notes: list[str]) -> tuple[float, str]:
    if unit == "auto":
        return _guessed_unit(clip, found, rig_mm, rig, notes)
    mm, source = _given_unit(unit)
    if not rig_mm / ABSURD < found * mm < rig_mm * ABSURD:
        raise InputError(_absurd(clip, found * mm, rig_mm, rig, f"reading.unit={unit}"))
    return mm, source


def _guessed_unit(clip: MeshSequence, found: float, rig_mm: float, rig: str, notes: list[str]) -> tuple[float, str]:
    if clip.unit_mm and rig_mm / ABSURD < found * clip.unit_mm < rig_mm * ABSURD:
        return clip.unit_mm, AS_THE_FILE_SAYS
    misfits = {name: abs(math.log(found * UNITS[name] / rig_mm)) for name in GUESSED} if found > 0 else {}
    best = min(misfits, key=misfits.get, default=None)
    if best is None or misfits[best] > math.log(FITS):
        raise InputError(_absurd(clip, found * (clip.unit_mm or 1.0), rig_mm, rig, "its own numbers"))
    said = f", not of {clip.unit_mm:g} mm as the file says" if clip.unit_mm else ""
    notes.append(
        f"units of {best} guessed{said}: its mesh measures {length(found * UNITS[best])} so, that of rig '{rig}' "
        f"{length(rig_mm)} (reading.unit={best} says it)"
    )
    return UNITS[best], GUESSED_SOURCE


def _absurd(clip: MeshSequence, found_mm: float, rig_mm: float, rig: str, taken: str) -> str:
    return (
        f"{clip.path}: with {taken} its mesh measures {length(found_mm)}, and that of rig '{rig}' {length(rig_mm)}: give "
        f"the unit with reading.unit=mm, cm, m or millimetres to a unit as a number (about {rig_mm / max(found_mm, 1e-30):.3g} "
        f"times as much fits)"
    )


def _up(clip: MeshSequence, up: Any, notes: list[str]) -> tuple[str, str]:
    if up == "auto":
        if clip.up:
            return clip.up, AS_THE_FILE_SAYS
        notes.append("y taken for up, as in most face and game software (reading.up=z if the clip lies on its back)")
        return "y", GUESSED_SOURCE
    if up not in TO_Y_UP:
        raise InputError(f"reading.up is {up!r}, expected auto, x, y or z")
    return up, AS_GIVEN


def _fps(clip: MeshSequence, fps: Any, notes: list[str]) -> tuple[float, str]:
    if fps is not None:
        if not _positive(fps) or fps > 1e6:
            raise InputError(f"reading.fps is {fps!r}, expected frames a second, a number above 0")
        return float(fps), AS_GIVEN
    if clip.fps is None:
        notes.append(f"{DEFAULT_FPS:g} frames a second taken, because the file does not say (reading.fps=...)")
        return DEFAULT_FPS, GUESSED_SOURCE
    if not _positive(clip.fps) or clip.fps > 1e6:
        raise InputError(f"{clip.path}: {clip.fps:g} frames a second, expected a number above 0: give it with reading.fps=...")
    return float(clip.fps), clip.facts.rate_source or AS_THE_FILE_SAYS


def _positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value > 0


def _size_of_clip(clip: MeshSequence) -> float:
    """The size of the first mesh that has enough known vertices, in the clip's own units."""
    for start in range(len(clip)):
        points = clip.read(start, start + 1)[0]
        known = np.isfinite(points).all(axis=1)
        if known.mean() > 0.5:
            return _size(points[known])
    raise InputError(f"{clip.path}: no frame has more than half of its vertices: there is nothing to invert")


def _size(points: np.ndarray) -> float:
    """How far apart the vertices lie: twice their root mean square distance from their middle, however they are turned."""
    points = points.astype(np.float64)
    return 2 * float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
