"""Sequences of OBJ or PLY files, one per frame; every file must hold the mesh of the first."""

from pathlib import Path

import numpy as np

from riginv.clips.numbered import find_frames
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, ScansError, SourceFacts
from riginv.errors import InputError, listed
from riginv.meshes.mesh_file import MeshFile, note_on_objects
from riginv.meshes.reading import read_mesh

REMEDY = "export them again, or correspondence=surface fits each as a scan"


class FileFrames(MeshSequence):
    """A sequence of files, one per frame; the vertex order of the files is kept.

    Args:
        path: as in `find_frames`.
        options: how the files are read.

    Raises:
        InputError: there are no files, some are missing, or the first is no mesh.
    """

    suffix: str

    def __init__(self, path: str, options: ReadingOptions) -> None:
        self.frames = find_frames(path, self.suffix, options.missing_frames == "bridge")
        first = read_mesh(self.frames.first)
        self.face_bytes, self.first_faces, self.points_in_file = first.face_bytes, first.polygons(), len(first.points)
        names = first.objects
        meshes = tuple(name for name in names if name in options.mesh_names) if names and options.mesh_names else names
        self.selected = vertices_of(first, options.mesh_names) if names and options.mesh_names else None
        notes = (*self.frames.notes, *first.notes, *options.unused(self.suffix[1:].upper(), not names))
        notes += note_on_objects(first.path, meshes)
        left_out = tuple(name for name in names if name not in meshes)
        facts = SourceFacts(self.suffix[1:].upper(), meshes, left_out, notes=notes)
        faces, count = self.first_faces, len(first.points)
        if self.selected is not None:
            if faces is not None:
                faces.check(path, count)
                faces = faces.among(self.selected)
            count = len(self.selected)
        super().__init__(path, self.frames.numbers, count, faces, facts=facts)

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
        if len(mesh.points) != self.points_in_file:
            raise ScansError(
                f"{path}: {len(mesh.points)} vertices, and {first} has {self.points_in_file}: all must be one mesh; {REMEDY}"
            )
        if mesh.face_bytes != self.face_bytes:
            found, expected = mesh.polygons(), self.first_faces
            if found is not None and expected is not None and not found.same_as(expected):
                raise ScansError(
                    f"{path}: its {len(found)} faces are not the {len(expected)} of {first}: all frames must be the same mesh "
                    f"with its vertices in the same order; {REMEDY}"
                )
        return mesh.points if self.selected is None else mesh.points[self.selected]


def vertices_of(mesh: MeshFile, names: list[str]) -> np.ndarray:
    """The sorted vertex indices `(vertex,)` of some objects.

    Raises:
        InputError: an object does not exist or has no vertices.
    """
    for name in names:
        if name not in mesh.objects or not len(mesh.vertices_of(name)):
            what = "has no vertices of its own" if name in mesh.objects else "is no object"
            raise InputError(
                f"{mesh.path}: reading.mesh names {name!r}, which {what} there; its objects: {listed(mesh.objects)}"
            )
    return np.unique(np.concatenate([mesh.vertices_of(name) for name in names]))


class ObjFrames(FileFrames):
    """Wavefront OBJ files."""

    suffix = ".obj"


class PlyFrames(FileFrames):
    """PLY files, in text or binary."""

    suffix = ".ply"
