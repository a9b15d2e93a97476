"""Options of reading a clip: the config groups `reading` and `frames`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from riginv.config.values import Bound
from riginv.errors import InputError

UNITS = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0, "inch": 25.4, "foot": 304.8}  # millimetres per unit
AXES = ("x", "y", "z")
MISSING_FRAMES = ("error", "bridge")
UNKNOWN_NAMES = ("error", "ignore_missing", "ignore_new", "ignore_both")


@dataclass(frozen=True)
class ReadingOptions:
    """Options of reading a clip's file.

    Attributes:
        unit: `auto`, a name in `UNITS`, or millimetres per unit; `auto`: as the file says, or guessed from the rig's size.
        scale: factor on top of the unit.
        up: `auto`, `x`, `y` or `z`.
        fps: frames per second; None: as the file says, or 30.
        mesh: name or path of the mesh to read, or several; None: the reader chooses.
        animation: name or number (from 1) of the animation to read, or several that glTF plays together; None: the first that
            moves the chosen meshes.
        vertices: file with the index of the clip's vertex for each vertex of the rig, -1 for none; None: the same order.
        check_faces: whether faces are compared with the rig's.
        missing_frames: `error`, or `bridge`: missing files of a numbered sequence are unknown frames.
        unknown: policy for names in a recording or in curves that do not match the rig: `error`; `ignore_new`: names that the
            rig lacks are left out; `ignore_missing`: what the file lacks stays at rest; `ignore_both`.
        interpreter: a Python with bpy, or Blender, for Alembic and FBX; None: $RIGINV_BLENDER, or this Python.
        readers: class paths of further readers by suffix without its dot: `glb: rigs.gltf.clip.GltfClip`.

    Raises:
        InputError: a value is invalid.
    """

    unit: str | float = "auto"
    scale: float = 1.0
    up: str = "auto"
    fps: float | None = None
    mesh: str | Sequence[str] | None = None
    animation: str | int | Sequence[str | int] | None = None
    vertices: str | None = None
    check_faces: bool = True
    missing_frames: str = "error"
    unknown: str = "error"
    interpreter: str | None = None
    readers: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        mm = UNITS.get(self.unit) if isinstance(self.unit, str) else self.unit
        if self.unit != "auto" and not _is_positive(mm):
            units = ", ".join(UNITS)
            raise InputError(f"reading.unit is {self.unit!r}, expected auto, {units}, or millimetres to a unit as a number")
        if not _is_positive(self.scale):
            raise InputError(f"reading.scale is {self.scale!r}, expected a number above 0")
        if self.up not in ("auto", *AXES):
            raise InputError(f"reading.up is {self.up!r}, expected auto, x, y or z")
        if self.fps is not None and not (_is_positive(self.fps) and self.fps <= 1e6):
            raise InputError(f"reading.fps is {self.fps!r}, expected frames a second, a number above 0")
        if self.missing_frames not in MISSING_FRAMES:
            raise InputError(f"reading.missing_frames is {self.missing_frames!r}, expected {' or '.join(MISSING_FRAMES)}")
        if self.unknown not in UNKNOWN_NAMES:
            raise InputError(f"reading.unknown is {self.unknown!r}, expected one of {', '.join(UNKNOWN_NAMES)}")

    @property
    def accepts_new(self) -> bool:
        """Whether names that the rig lacks are left out."""
        return self.unknown in ("ignore_new", "ignore_both")

    @property
    def accepts_missing(self) -> bool:
        """Whether what the file lacks stays at rest."""
        return self.unknown in ("ignore_missing", "ignore_both")

    @property
    def mesh_names(self) -> list[str]:
        """The requested meshes; empty: the reader chooses."""
        if self.mesh is None:
            return []
        return [str(name) for name in self.mesh] if isinstance(self.mesh, list | tuple) else [str(self.mesh)]

    def unused(self, format: str, mesh: bool = True) -> tuple[str, ...]:
        """Notes on options that a format with one animation, and with `mesh` one unnamed mesh, cannot use."""
        keys = ["mesh"] * (mesh and self.mesh is not None) + ["animation"] * (self.animation is not None)
        return tuple(f"reading.{key}={getattr(self, key)} was ignored: {format} holds one {key}." for key in keys)


@dataclass(frozen=True)
class FrameOptions:
    """The selection of a clip's frames, by the frame numbers of its source.

    Attributes:
        first, last: both included; None: from the start, to the end.
        exclude: frames to treat as unknown, as numbers or ranges such as `120-135`.
    """

    first: int | None = None
    last: int | None = None
    exclude: Annotated[Sequence[int | str], Bound("a list of frames: frames.exclude=[17,120-135]", lambda value: True)] = ()


def _is_positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and value > 0
