"""A sequence with a file for each frame: OBJ and PLY; every file must have the mesh of the first."""

from pathlib import Path

import numpy as np

from riginv.clips.numbered import find_frames
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, SourceFacts
from riginv.errors import InputError
from riginv.meshes.mesh_file import note_on_objects
from riginv.meshes.reading import read_mesh


class FileFrames(MeshSequence):
    """Files, one for each frame; the order of their vertices is kept.

    Args:
        path: as in `find_frames`.
        options: what the user says about the files.

    Raises:
        InputError: there are no files, some are missing, or the first one is no mesh.
    """

    suffix: str

    def __init__(self, path: str, options: ReadingOptions) -> None:
        self.frames = find_frames(path, self.suffix, options.missing_frames == "bridge")
        first = read_mesh(self.frames.first)
        self.face_bytes = first.face_bytes
        facts = SourceFacts(
            self.suffix[1:].upper(), first.objects, notes=(*self.frames.notes, *first.notes, *note_on_objects(first))
        )
        super().__init__(path, self.frames.numbers, len(first.points), first.polygons(), facts=facts)

    def read(self, start: int, stop: int) -> np.ndarray:
        values = np.full((stop - start, self.vertex_count, 3), np.nan, np.float32)
        for frame, path in zip(values, self.frames.paths[start:stop]):
            if path is not None:
                with np.errstate(over="ignore", invalid="ignore"):
                    frame[:] = self._checked(path)
        return values

    def _checked(self, path: Path) -> np.ndarray:
        mesh = read_mesh(path)
        first = self.frames.first.name
        if len(mesh.points) != self.vertex_count:
            raise InputError(
                f"{path}: {len(mesh.points)} vertices, and {first} has {self.vertex_count}: all frames must be the same mesh: "
                f"export them again"
            )
        if mesh.face_bytes != self.face_bytes:
            found, expected = mesh.polygons(), self.faces
            if found is not None and expected is not None and not found.same_as(expected):
                raise InputError(
                    f"{path}: its {len(found)} faces are not the {len(expected)} of {first}: all frames must be the same mesh "
                    f"with its vertices in the same order; export them again"
                )
        return mesh.points


class ObjFrames(FileFrames):
    """Wavefront OBJ files."""

    suffix = ".obj"


class PlyFrames(FileFrames):
    """PLY files, in text or binary."""

    suffix = ".ply"
