"""A sequence with a file for each frame: OBJ and PLY; every file must have the mesh of the first."""

from abc import abstractmethod
from pathlib import Path

import numpy as np

from riginv.clips.files import read_bytes
from riginv.clips.numbered import find_frames
from riginv.clips.obj_text import face_lines, read_points, read_polygons
from riginv.clips.options import ReadingOptions
from riginv.clips.ply_file import read_ply
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.errors import InputError


class FileFrames(MeshSequence):
    """Files, one for each frame.

    Args:
        path: as in `find_frames`.
        options: what the user says about the files.

    Raises:
        InputError: there are no files, some are missing, or the first one is no mesh.
    """

    suffixes: tuple[str, ...] = ()

    def __init__(self, path: str, options: ReadingOptions) -> None:
        self.frames = find_frames(path, self.suffixes, options.missing_frames == "bridge")
        points, self.face_bytes = self.parse(self.frames.first)
        super().__init__(path, self.frames.numbers, len(points), self.polygons(self.frames.first))

    @abstractmethod
    def parse(self, path: Path) -> tuple[np.ndarray, bytes]:
        """The vertices `(vertex, 3)` of a file, and the bytes that hold its faces."""

    @abstractmethod
    def polygons(self, path: Path) -> Polygons | None:
        """The faces of a file."""

    def read(self, start: int, stop: int) -> np.ndarray:
        values = np.full((stop - start, self.vertex_count, 3), np.nan, np.float32)
        for place, path in zip(values, self.frames.paths[start:stop]):
            if path is not None:
                place[:] = self._checked(path)
        return values

    def _checked(self, path: Path) -> np.ndarray:
        points, face_bytes = self.parse(path)
        first = self.frames.first.name
        if len(points) != self.vertex_count:
            raise InputError(
                f"{path}: {len(points)} vertices, and {first} has {self.vertex_count}: all frames must be the same mesh: "
                f"export them again"
            )
        if face_bytes != self.face_bytes:
            found, expected = self.polygons(path), self.faces
            if found is not None and expected is not None and not found.same_as(expected):
                raise InputError(
                    f"{path}: its {len(found)} faces are not the {len(expected)} of {first}: all frames must be the same mesh "
                    f"with its vertices in the same order; export them again"
                )
        return points


class ObjFrames(FileFrames):
    """Wavefront OBJ files; the order of their vertices is kept."""

    suffixes = (".obj",)

    def parse(self, path: Path) -> tuple[np.ndarray, bytes]:
        data = read_bytes(path)
        return read_points(path, data), face_lines(data)

    def polygons(self, path: Path) -> Polygons | None:
        return read_polygons(path, read_bytes(path))


class PlyFrames(FileFrames):
    """PLY files, in text or binary; the order of their vertices is kept."""

    suffixes = (".ply",)

    def parse(self, path: Path) -> tuple[np.ndarray, bytes]:
        mesh = read_ply(path, read_bytes(path))
        return mesh.points, mesh.face_bytes

    def polygons(self, path: Path) -> Polygons | None:
        return read_ply(path, read_bytes(path)).polygons()
