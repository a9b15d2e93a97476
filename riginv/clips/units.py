"""Units of a clip: millimetres per unit, up axis, frame rate; from options, the file, or a guess that a note explains."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import torch

from riginv.clips.options import UNITS, ReadingOptions
from riginv.clips.sequence import MeshSequence, SourceFacts
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.rig.size import length

DEFAULT_FPS = 30.0
UP_ASSUMED = "the file does not say which axis is up: y is assumed"
AS_GIVEN, AS_THE_FILE_SAYS, GUESSED = "as given", "as the file says", "guessed"  # sources of a value
# Rotations that turn an up axis to y.
TO_Y_UP = {
    "x": torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "y": torch.eye(3),
    "z": torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}


class Source(Protocol):
    """The interface of clips whose units are resolved: sequences of meshes or of scans, see `MeshSequence`."""

    path: str
    facts: SourceFacts
    fps: float | None
    unit_mm: float | None
    up: str | None


@dataclass(frozen=True)
class SizeLimits:
    """Limits for the comparison of a clip's size with the rig's.

    Attributes:
        guessed: units to guess from; the first of two that fit equally is taken.
        guess_ratio: largest ratio of the two sizes, either way, for a guessed unit.
        given_ratio: largest ratio for a unit that the user or the file gives.
    """

    guessed: tuple[str, ...] = ("mm", "cm", "dm", "m", "inch")
    guess_ratio: float = 1.25
    given_ratio: float = 4.0


class ClipUnits(NamedTuple):
    """Conversion of a clip to millimetres, y up.

    Attributes:
        mm: millimetres per unit of the clip.
        axes: rotation `(3, 3)` that turns points of the clip to y up.
        fps: frames per second.
        notes: what was guessed, and why.
        unit_source, up_source, rate_source: where the value comes from, such as `as the file says`. If `unit_source` is empty
            the unit is not known, `mm` is 1 and lengths are in the file's unit.
        up: the up axis of the file.
    """

    mm: float
    axes: torch.Tensor
    fps: float
    notes: list[str]
    unit_source: str = AS_GIVEN
    up: str = "y"
    up_source: str = AS_GIVEN
    rate_source: str = AS_GIVEN


def resolve_units(clip: MeshSequence, rig: RigBackend, reading: ReadingOptions) -> ClipUnits:
    """The units of a clip of a rig; a unit that neither options nor file give is guessed from its size.

    Args:
        reading: `unit`, `scale`, `up`, `fps`.

    Raises:
        InputError: the clip would be absurdly small or large beside the rig.
    """
    return units_from_size(
        clip, _size_of_clip(clip), rms_size(rig.rest_vertices.cpu().numpy()), rig.name, reading, SizeLimits()
    )


def units_from_size(
    clip: Source, size: float, rig_mm: float, rig: str, reading: ReadingOptions, limits: SizeLimits
) -> ClipUnits:
    """The units of a clip whose size, in its own unit, is compared with that of a rig.

    Args:
        size, rig_mm: measured in the same way.
        rig: name of the rig, for messages.

    Raises:
        InputError: as `resolve_units`.
    """
    notes: list[str] = []
    size *= reading.scale
    mm = given_mm = _given_mm(clip, reading)
    source = AS_THE_FILE_SAYS if reading.unit == "auto" else AS_GIVEN
    if reading.unit == "auto" and not _similar(size * (given_mm or 0.0), rig_mm, limits.given_ratio):
        mm, source = _guessed_mm(clip, size, rig_mm, rig, limits, notes), GUESSED
    assert mm is not None
    if not _similar(size * mm, rig_mm, limits.given_ratio):
        raise _absurd(clip, size, mm, rig_mm, rig, f"reading.unit={reading.unit}")
    return _units(clip, mm, source, reading, notes)


def resolve_units_without_rig(clip: Source, reading: ReadingOptions) -> ClipUnits:
    """The units of a clip where there is no rig to compare its size with."""
    mm = _given_mm(clip, reading)
    source = "" if mm is None else AS_THE_FILE_SAYS if reading.unit == "auto" else AS_GIVEN
    return _units(clip, mm or 1.0, source, reading, [])


def _units(clip: Source, mm: float, source: str, reading: ReadingOptions, notes: list[str]) -> ClipUnits:
    fps, rate_source = _fps(clip, reading, notes)
    up, up_source = _up(clip, reading, notes)
    return ClipUnits(mm * reading.scale, TO_Y_UP[up], fps, notes, source, up, up_source, rate_source)


def _given_mm(clip: Source, reading: ReadingOptions) -> float | None:
    """Millimetres per unit as the options or the file give them, else None."""
    if reading.unit == "auto":
        return clip.unit_mm or None
    return UNITS[reading.unit] if isinstance(reading.unit, str) else reading.unit


def _similar(mm: float, rig_mm: float, ratio: float) -> bool:
    return rig_mm / ratio < mm < rig_mm * ratio


def _guessed_mm(clip: Source, size: float, rig_mm: float, rig: str, limits: SizeLimits, notes: list[str]) -> float:
    misfits = {unit: abs(math.log(size * UNITS[unit] / rig_mm)) for unit in limits.guessed} if size > 0 else {}
    best = min(misfits, key=lambda unit: misfits[unit], default="")
    if not best or misfits[best] > math.log(limits.guess_ratio):
        raise _absurd(clip, size, clip.unit_mm or 1.0, rig_mm, rig, "the file's unit" if clip.unit_mm else "units of mm")
    other = f", not of {clip.unit_mm:g} mm as the file says" if clip.unit_mm else ""
    notes.append(
        f"units of {best} guessed{other}: in these the mesh is {size * UNITS[best] / rig_mm:.2f} times as large as rig "
        f"'{rig}' (set the unit with reading.unit={best})"
    )
    return UNITS[best]


def _absurd(clip: Source, size: float, mm: float, rig_mm: float, rig: str, taken: str) -> InputError:
    if not size > 0:
        return InputError(f"{clip.path}: all points of its mesh are one, expected the shape of rig '{rig}': export it again")
    return InputError(
        f"{clip.path}: with {taken} its mesh measures {length(size * mm)}, and that of rig '{rig}' {length(rig_mm)}: set the "
        f"clip's unit with reading.unit=mm, cm, m or a number of millimetres (about {float(f'{rig_mm / size:.2g}'):,g} would "
        f"fit), or the rig's, if that is what is wrong (rig.unit_mm of most rigs)"
    )


def _up(clip: Source, reading: ReadingOptions, notes: list[str]) -> tuple[str, str]:
    if reading.up != "auto":
        return reading.up, AS_GIVEN
    if clip.up:
        return clip.up, AS_THE_FILE_SAYS
    notes.append(f"{UP_ASSUMED} (reading.up=z if the clip lies on its back)")
    return "y", GUESSED


def _fps(clip: Source, reading: ReadingOptions, notes: list[str]) -> tuple[float, str]:
    if reading.fps is not None:
        return float(reading.fps), AS_GIVEN
    if clip.fps is None:
        notes.append(
            f"the file does not say its frame rate: {DEFAULT_FPS:g} frames a second are assumed (reading.fps=24 for another)"
        )
        return DEFAULT_FPS, GUESSED
    if not 0 < clip.fps <= 1e6:
        raise InputError(f"{clip.path}: {clip.fps:g} frames a second, expected a number above 0: give it with reading.fps=...")
    return float(clip.fps), clip.facts.rate_source or AS_THE_FILE_SAYS


def _size_of_clip(clip: MeshSequence) -> float:
    """The size of the first mesh that has enough known vertices, in the clip's unit."""
    for start in range(len(clip)):
        points = clip.read(start, start + 1)[0]
        known = np.isfinite(points).all(axis=1)
        if known.mean() > 0.5:
            return rms_size(points[known])
    raise InputError(f"{clip.path}: no frame has more than half of its vertices: there is nothing to invert")


def rms_size(points: np.ndarray) -> float:
    """Twice the root mean square distance of points `(point, 3)` from their mean: a size that rotations do not change."""
    points = points.astype(np.float64)
    return 2 * float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
