"""What a clip's numbers mean: millimetres to a unit, which axis points up, frames a second; guessed only with a reason."""

import math
from typing import Any, NamedTuple

import numpy as np
import torch

from riginv.clips.sequence import MeshSequence
from riginv.errors import InputError
from riginv.rig import RigBackend

UNITS = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0, "inch": 25.4, "foot": 304.8}
GUESSED = ("mm", "cm", "dm", "m", "inch")  # in this order where two fit alike
FITS = 1.25  # times the rig's size that a clip may be, either way, for a unit to be guessed
ABSURD = 4.0  # times the rig's size beyond which a unit that was given is called out
DEFAULT_FPS = 30.0
# Rotations that bring an axis up: the clip's x, y, z as rows of what they become.
TO_Y_UP = {
    "x": torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "y": torch.eye(3),
    "z": torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}


class Meaning(NamedTuple):
    """How a clip's numbers become millimetres, y up.

    Attributes:
        mm: to a unit of the clip.
        axes: `(3, 3)`: what turns a point of the clip upright.
        fps: frames a second.
        notes: what was guessed, and why.
    """

    mm: float
    axes: torch.Tensor
    fps: float
    notes: list[str]


def meaning_of(clip: MeshSequence, rig: RigBackend, unit: Any, scale: Any, up: Any, fps: Any) -> Meaning:
    """What a clip's numbers mean.

    Args:
        unit: a key of UNITS, millimetres to a unit as a number, or `auto`.
        scale: a factor on top of that.
        up: `x`, `y`, `z` or `auto`.
        fps: frames a second, or None: what the file says.

    Raises:
        InputError: a value is none of these, or the clip would be absurdly small or large beside the rig.
    """
    if not _positive(scale):
        raise InputError(f"reading.scale is {scale!r}, expected a number above 0")
    notes: list[str] = []
    found = _size_of_clip(clip)
    rig_mm = _size(rig.rest_vertices.cpu().numpy())
    mm = _unit(clip, unit, found * scale, rig_mm, rig.name, notes) * scale
    rate = _fps(clip, fps, notes)
    return Meaning(mm, TO_Y_UP[_up(clip, up, notes)], rate, notes)


def _unit(clip: MeshSequence, unit: Any, found: float, rig_mm: float, rig: str, notes: list[str]) -> float:
    if unit == "auto":
        return _guessed_unit(clip, found, rig_mm, rig, notes)
    mm = UNITS.get(unit) if isinstance(unit, str) else unit
    if not _positive(mm):
        raise InputError(f"reading.unit is {unit!r}, expected auto, {', '.join(UNITS)}, or millimetres to a unit as a number")
    if not rig_mm / ABSURD < found * mm < rig_mm * ABSURD:
        raise InputError(_absurd(clip, found * mm, rig_mm, rig, f"reading.unit={unit}"))
    return mm


def _guessed_unit(clip: MeshSequence, found: float, rig_mm: float, rig: str, notes: list[str]) -> float:
    if clip.unit_mm and rig_mm / ABSURD < found * clip.unit_mm < rig_mm * ABSURD:
        if not clip.in_rig_space:
            notes.append(f"units of {clip.unit_mm:g} mm, as the file says")
        return clip.unit_mm
    misfits = {name: abs(math.log(found * UNITS[name] / rig_mm)) for name in GUESSED} if found > 0 else {}
    best = min(misfits, key=misfits.get, default=None)
    if best is None or misfits[best] > math.log(FITS):
        raise InputError(_absurd(clip, found * (clip.unit_mm or 1.0), rig_mm, rig, "its own numbers"))
    said = f", not of {clip.unit_mm:g} mm as the file says" if clip.unit_mm else ""
    notes.append(
        f"units of {best} guessed{said}: its mesh measures {_length(found * UNITS[best])} so, that of rig '{rig}' "
        f"{_length(rig_mm)} (reading.unit={best} says it)"
    )
    return UNITS[best]


def _absurd(clip: MeshSequence, found_mm: float, rig_mm: float, rig: str, taken: str) -> str:
    return (
        f"{clip.path}: with {taken} its mesh measures {_length(found_mm)}, and that of rig '{rig}' {_length(rig_mm)}: give "
        f"the unit with reading.unit=mm, cm, m or millimetres to a unit as a number (about {rig_mm / max(found_mm, 1e-30):.3g} "
        f"times as much fits)"
    )


def _up(clip: MeshSequence, up: Any, notes: list[str]) -> str:
    if up == "auto":
        if clip.up and clip.in_rig_space:
            return clip.up
        if clip.up:
            notes.append(f"{clip.up} is up, as the file says")
        else:
            notes.append("y taken for up, as in most face and game software (reading.up=z if the clip lies on its back)")
        return clip.up or "y"
    if up not in TO_Y_UP:
        raise InputError(f"reading.up is {up!r}, expected auto, x, y or z")
    return up


def _fps(clip: MeshSequence, fps: Any, notes: list[str]) -> float:
    if fps is not None:
        if not _positive(fps) or fps > 1e6:
            raise InputError(f"reading.fps is {fps!r}, expected frames a second, a number above 0")
        return float(fps)
    if clip.fps is None:
        notes.append(f"{DEFAULT_FPS:g} frames a second taken, because the file does not say (reading.fps=...)")
        return DEFAULT_FPS
    if not _positive(clip.fps) or clip.fps > 1e6:
        raise InputError(f"{clip.path}: {clip.fps:g} frames a second, expected a number above 0: give it with reading.fps=...")
    return float(clip.fps)


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


def _length(mm: float) -> str:
    """A length as people would say it."""
    if not math.isfinite(mm):
        return "infinitely much"
    for unit, size in (("km", 1e6), ("m", 1e3)):
        if mm >= 10 * size:
            return f"{mm / size:.3g} {unit}"
    return f"{mm:.0f} mm" if mm >= 100 else f"{mm:.3g} mm"
