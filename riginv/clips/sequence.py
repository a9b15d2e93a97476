"""The interface of clip readers: a sequence of meshes as the file has them, read window by window."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from riginv.meshes.mesh_file import MeshFile
from riginv.meshes.polygons import Polygons
from riginv.rig.interface import RigBackend

MAX_VERTICES = 50_000_000  # of one mesh; more means a damaged file


@dataclass(frozen=True)
class SourceFacts:
    """Facts for the user about a file: what its reader has read and skipped.

    Attributes:
        format: name of the format: `USD`, `glTF`, `Live Link Face CSV`.
        meshes: names of the meshes read, in the order of their vertices.
        other_meshes: names of the meshes left out.
        animation: name of the animation read, where a file can hold several.
        other_animations: names of the animations not read.
        rate_source: where the frame rate comes from: `timeCodesPerSecond`, `the spacing of its keys`.
        notes: sentences: what was repaired, guessed, or is contradictory.
    """

    format: str
    meshes: tuple[str, ...] = ()
    other_meshes: tuple[str, ...] = ()
    animation: str = ""
    other_animations: tuple[str, ...] = ()
    rate_source: str = ""
    notes: tuple[str, ...] = ()


class ScansError(InputError):
    """A file cannot be read as a clip of one mesh, and can as a clip of scans (`correspondence=surface`)."""


class MeshesError(InputError):
    """A file holds several meshes, and it is not clear which is meant.

    Attributes:
        meshes: name, vertices and frames of each; one frame: it never moves.
    """

    def __init__(self, message: str, meshes: Sequence[tuple[str, int, int]]) -> None:
        super().__init__(message)
        self.meshes = meshes


Reader = Callable[[str, ReadingOptions], "MeshSequence"]  # opens a path


class MeshSequence(ABC):
    """A sequence of meshes of one topology, in the units and axes of the file; only a window is in memory.

    Attributes:
        path: the name in messages.
        facts: what was read and what was left out.
        frame_numbers: `(frame,)`, as in the source, rising.
        vertex_count: of each mesh.
        faces: None where the file has none.
        fps: frames per second; None where the file does not give it.
        unit_mm: millimetres per unit; None where the file does not give it.
        up: the up axis, `x`, `y` or `z`; None where the file does not give it.
        in_rig_space: whether the meshes were made from the rig, so that they have no rigid motion.
        controls: the rig's controls that made the meshes, `(frame, control)`; None where they are not known.
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
        if not 1 <= self.vertex_count <= MAX_VERTICES:
            raise InputError(f"{path}: meshes of {self.vertex_count} vertices, expected 1 to {MAX_VERTICES}: export it again")
        if (np.diff(self.frame_numbers) <= 0).any():
            raise InputError(f"{path}: its frame numbers do not rise: each frame may occur once; renumber them")
        if faces is not None:
            faces.check(path, self.vertex_count)

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> "MeshSequence":
        """Open a file that should hold a rig's mesh; readers of scenes use the rig to choose the meshes.

        Raises:
            InputError: the file cannot be read.
        """
        reader: Reader = cls  # readers take these two arguments
        return reader(path, options)

    @classmethod
    def for_scans(cls, path: str, options: ReadingOptions, rig: RigBackend | None) -> "MeshSequence":
        """Open a file whose frames may each be another mesh, where the format can hold such: `mesh` reads them.

        Args:
            rig: that scans are fitted with; other formats are read for it, as by `for_rig`. None: no rig.

        Raises:
            InputError: the file cannot be read.
        """
        reader: Reader = cls
        return reader(path, options) if rig is None else cls.for_rig(path, options, rig)

    @classmethod
    def still(cls, path: Path, options: ReadingOptions) -> MeshFile:
        """The mesh in a file as it is without an animation, for formats that have a file for each scan.

        Raises:
            InputError: the file cannot be read, or the format is read as a whole clip.
        """
        raise InputError(f"{path}: not read as a scan of its own: export each frame as .obj, .ply or .glb")

    def __len__(self) -> int:
        return len(self.frame_numbers)

    @abstractmethod
    def read(self, start: int, stop: int) -> np.ndarray:
        """Meshes `start` to `stop`, `(frame, vertex, 3)` float32; NaN where a vertex is not known.

        Raises:
            InputError: the file turns out to be damaged there.
        """

    def mesh(self, index: int) -> tuple[np.ndarray, Polygons | None]:
        """One frame: points `(vertex, 3)`, and its faces, None where the file has none.

        Raises:
            InputError: as `read`.
        """
        return self.read(index, index + 1)[0], self.faces
