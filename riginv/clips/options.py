"""What a user may say about a clip: the groups `reading` and `frames` of the commands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from riginv.errors import InputError

MISSING_FRAMES = ("error", "bridge")
UNKNOWN_NAMES = ("error", "ignore_missing", "ignore_new", "ignore_both")


@dataclass(frozen=True)
class ReadingOptions:
    """How a clip's file is read.

    Attributes:
        unit: `auto`, a name in `riginv.clips.units.UNITS`, or millimetres to a unit.
        scale: factor on top of the unit.
        up: `auto`, `x`, `y` or `z`.
        fps: frames a second; None: what the file says.
        mesh: name or path of the mesh to read, or several; None: the reader chooses.
        animation: name of the animation to read, or its number from 1, or several that glTF plays together; None: the first
            that moves the chosen meshes.
        vertices: a file with the clip's vertex for each vertex of the rig, -1 for none; None: the same order.
        check_faces: whether faces are compared with the rig's.
        missing_frames: `error`, or `bridge`: frames of a numbered sequence that have no file count as unknown.
        unknown: what happens with names in a recording or in curves that do not fit the rig: `error`; `ignore_new`: names that
            the rig lacks are left out; `ignore_missing`: what the file does not name stays at rest; `ignore_both`.
        interpreter: a Python with bpy, or Blender, for Alembic and FBX; None: $RIGINV_BLENDER, or this Python.

    Raises:
        InputError: `missing_frames` or `unknown` is none of its choices.
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

    def __post_init__(self) -> None:
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
        """Whether what a file does not name stays at rest."""
        return self.unknown in ("ignore_missing", "ignore_both")

    @property
    def mesh_names(self) -> list[str]:
        """The meshes that were asked for; empty: none in particular."""
        if self.mesh is None:
            return []
        return [str(name) for name in self.mesh] if isinstance(self.mesh, list | tuple) else [str(self.mesh)]

    def unused(self, format: str, mesh: bool = True) -> tuple[str, ...]:
        """Says what has no meaning for a format that holds one animation, and with `mesh` one mesh without a name."""
        keys = ["mesh"] * (mesh and self.mesh is not None) + ["animation"] * (self.animation is not None)
        return tuple(f"reading.{key}={getattr(self, key)} was passed over: {format} holds one {key}." for key in keys)


@dataclass(frozen=True)
class FrameOptions:
    """Which frames of a clip are taken, as its source counts them.

    Attributes:
        first, last: both included; None: from the start, to the end.
        exclude: frames to treat as unknown, as numbers or spans `120-135`.
    """

    first: int | None = None
    last: int | None = None
    exclude: Sequence[Any] = field(default_factory=tuple)


def clip_options(config: Mapping[str, Any]) -> tuple[ReadingOptions, FrameOptions]:
    """The groups `reading` and `frames` of a config."""
    return ReadingOptions(**config["reading"]), FrameOptions(**config["frames"])
