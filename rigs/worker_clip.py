"""Clips that a worker process reads: Blender's formats and USD."""

from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshesError, MeshSequence, Polygons, ScansError, SourceFacts
from riginv.errors import InputError
from riginv.meshes.mesh_file import MeshFile
from riginv.rig.interface import RigBackend
from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.pool import PoseLostError, WorkerPool


class Source(NamedTuple):
    """The worker process that reads a file.

    Attributes:
        command: of the worker.
        timeout_s: for a chunk of frames, or for opening the file.
        file: absolute path, for the worker.
        format: its name for users.
    """

    command: list[str]
    timeout_s: float
    file: Path
    format: str


class WorkerClip(MeshSequence):
    """Meshes that a worker's script describes and then evaluates frame by frame.

    Args:
        path: of the file, as messages name it.
        options: `mesh`, `animation` and `fps`, for the script.
        vertices: number of vertices of the clip's rig, where known.
        ragged: whether each frame may be another mesh, as of scans; then `mesh` reads them, and not `read`.

    Raises:
        InputError: no such file, mesh or animation, or the worker cannot be started or cannot read the file.
    """

    def __init__(self, path: str, options: ReadingOptions, vertices: int | None = None, ragged: bool = False) -> None:
        source = self._source(path, options)
        load = {
            "file": str(source.file),
            "meshes": options.mesh_names,
            "animation": options.animation,
            "fps": options.fps,
            "vertices": vertices,
            "ragged": ragged,
        }
        self.path, self.ragged = path, ragged
        self.pool = WorkerPool(source.command, load, 1, source.timeout_s)
        try:
            facts, arrays = self.pool.describe(attempts=1)  # what ends its reader does so again, and a start takes seconds
        except (WorkerRefusedError, PoseLostError) as error:
            self.pool.close()
            raise self._error(error) from None
        polygons = self._polygons(arrays)
        super().__init__(
            path,
            arrays["frames"],
            max(facts["vertices"], int(ragged)),  # a scan may be empty
            polygons if len(polygons) else None,
            facts["fps"],
            facts["unit_mm"],
            facts["up"],
            SourceFacts(
                source.format,
                tuple(facts["meshes"]),
                tuple(facts["other_meshes"]),
                facts["animation"],
                tuple(facts["other_animations"]),
                facts["rate_source"],
                tuple(facts["notes"]),
            ),
        )

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> MeshSequence:
        """Open a clip of a rig, whose number of vertices selects the meshes unless the user names them.

        Raises:
            InputError: the file cannot be read, or it is not clear which meshes are meant.
        """
        return cls(path, options, None if options.vertices is not None else len(rig.rest_vertices))

    @classmethod
    def for_scans(cls, path: str, options: ReadingOptions, rig: RigBackend | None) -> MeshSequence:
        return cls(path, options, None if rig is None else len(rig.rest_vertices), ragged=True)

    @classmethod
    def still(cls, path: Path, options: ReadingOptions) -> MeshFile:
        clip = cls(str(path), options, ragged=True)
        try:
            return StillMesh(path, clip)
        finally:
            clip.pool.close()

    def mesh(self, index: int) -> tuple[np.ndarray, Polygons | None]:
        if not self.ragged:
            return super().mesh(index)
        try:
            arrays = self.pool.pose(["frame"], np.array([index], np.float32))
        except (WorkerRefusedError, PoseLostError) as error:
            raise self._error(error) from None
        polygons = self._polygons(arrays)
        polygons.check(self.path, len(arrays["vertices"][0]))
        return arrays["vertices"][0], polygons if len(polygons) else None

    def _polygons(self, arrays: Mapping[str, np.ndarray]) -> Polygons:
        sizes, corners = arrays["sizes"].astype(np.int64), arrays["corners"].astype(np.int64)
        if (sizes < 0).any() or sizes.sum() != len(corners):
            raise InputError(f"{self.path}: its faces need {sizes.sum()} corners and have {len(corners)}: export it again")
        return Polygons(sizes, corners)

    def read(self, start: int, stop: int) -> np.ndarray:
        try:
            return self.pool.evaluate(["frame"], np.arange(start, stop, dtype=np.float32)[:, None])
        except (WorkerRefusedError, PoseLostError) as error:
            raise self._error(error) from None

    @abstractmethod
    def _source(self, path: str, options: ReadingOptions) -> Source:
        """The worker process that reads a file.

        Raises:
            InputError: the file or the program is missing, or the file is of another format.
        """

    def _error(self, error: WorkerRefusedError | PoseLostError) -> InputError:
        if isinstance(error, WorkerRefusedError) and error.meshes:
            return MeshesError(self._failure(error), error.meshes)
        are_scans = isinstance(error, WorkerRefusedError) and error.are_scans
        return (ScansError if are_scans else InputError)(self._failure(error))

    @abstractmethod
    def _failure(self, error: Exception) -> str:
        """The message for a worker that refuses the file, or that is lost."""


class StillMesh(MeshFile):
    """The first frame of a clip as the mesh of a file."""

    def __init__(self, path: Path, clip: WorkerClip) -> None:
        points, self._polygons = clip.mesh(0)
        self.unit_mm, self.up = clip.unit_mm, clip.up
        notes = (f"{path.name} holds {len(clip)} frames: the first is the scan.",) if len(clip) > 1 else ()
        super().__init__(path, points.astype(np.float64), b"", notes)

    def polygons(self) -> Polygons | None:
        return self._polygons
