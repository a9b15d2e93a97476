"""What every reader of clips gives: a sequence of meshes, read a window at a time, as the file has it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from riginv.meshes.polygons import Polygons
from riginv.rig.interface import RigBackend

MOST_VERTICES = 50_000_000  # of one mesh; more is damage


@dataclass(frozen=True)
class SourceFacts:
    """What a reader took from a file and what it passed over, so that the user can be told.

    Attributes:
        format: of the file, as people call it: `USD`, `glTF`, `Live Link Face CSV`.
        meshes: names of the meshes that were read, in the order of their vertices.
        other_meshes: names of those that were left out.
        animation: name of the animation that was read, where a file can hold several.
        other_animations: names of those that were not.
        rate_source: where the frames a second come from: `timeCodesPerSecond`, `the spacing of its keys`.
        notes: whole sentences: what was mended, guessed, or contradicts itself.
    """

    format: str
    meshes: tuple[str, ...] = ()
    other_meshes: tuple[str, ...] = ()
    animation: str = ""
    other_animations: tuple[str, ...] = ()
    rate_source: str = ""
    notes: tuple[str, ...] = ()


class MeshSequence(ABC):
    """Meshes of one topology, one after the other, in the units and axes of their file; nothing is held but a window.

    Attributes:
        path: what messages call it.
        facts: what was read, and what was left out.
        frame_numbers: as the source counts them, `(frame,)`, rising.
        vertex_count: of each mesh.
        faces: where the file says them, else None.
        fps: frames a second, where the file says so, else None.
        unit_mm: millimetres to a unit, where the file says so, else None.
        up: the axis that points up, `x`, `y` or `z`, where the file says so, else None.
        in_rig_space: whether the meshes were made from a rig's own, so that no motion of the whole can be in them.
        controls: those of the rig that made them, `(frame, control)`, where the source holds such; else None.
    """

    in_rig_space: bool = False
    controls: np.ndarray | None = None

    def __init__(
        self,
        path: str | Path,
        frame_numbers: np.ndarray,
        vertex_count: int,
        faces: Polygons | None = None,
        fps: float | None = None,
        unit_mm: float | None = None,
        up: str | None = None,
        facts: SourceFacts | None = None,
    ) -> None:
        self.facts = facts or SourceFacts(Path(str(path)).suffix.lstrip(".").upper())
        self.path, self.frame_numbers, self.vertex_count = str(path), np.asarray(frame_numbers, np.int64), int(vertex_count)
        self.faces, self.fps, self.unit_mm, self.up = faces, fps, unit_mm, up
        if not len(self.frame_numbers):
            raise InputError(f"{path}: no frames in it; expected at least one mesh: export it again")
        if not 1 <= self.vertex_count <= MOST_VERTICES:
            raise InputError(f"{path}: meshes of {self.vertex_count} vertices, expected 1 to {MOST_VERTICES}: export it again")
        if (np.diff(self.frame_numbers) <= 0).any():
            raise InputError(f"{path}: its frame numbers do not rise: each frame may stand there once; number them anew")
        if faces is not None:
            faces.check(path, self.vertex_count)

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> "MeshSequence":
        """Open a file that should hold a rig's mesh; a reader of scenes may choose the meshes by it.

        Raises:
            InputError: the file cannot be read.
        """
        return cls(path, options)

    def __len__(self) -> int:
        return len(self.frame_numbers)

    @abstractmethod
    def read(self, start: int, stop: int) -> np.ndarray:
        """The meshes `start` to `stop`, `(frame, vertex, 3)` float32; NaN where a vertex is not known.

        Raises:
            InputError: the file turns out to be damaged there.
        """
