"""Validated sculpted meshes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.errors import InputError
from riginv.meshes.mesh_file import MeshFile, note_on_objects
from riginv.meshes.polygons import Polygons
from riginv.meshes.reading import read_mesh


@dataclass(frozen=True)
class Sculpt:
    """A mesh with finite coordinates and faces of at least three corners.

    Attributes:
        file: the file as it was read.
        faces: polygons.
    """

    file: MeshFile
    faces: Polygons

    @property
    def path(self) -> Path:
        return self.file.path

    @property
    def vertices(self) -> np.ndarray:
        """`(vertex, 3)`, in the file's unit."""
        return self.file.points

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences about repairs and merged objects."""
        return (*self.file.notes, *note_on_objects(self.path, self.file.objects))

    def check_like(self, neutral: "Sculpt") -> None:
        """Raises InputError where vertices or faces differ from the neutral's in number or order."""
        for what, here, there in (
            ("vertices", len(self.vertices), len(neutral.vertices)),
            ("faces", len(self.faces), len(neutral.faces)),
        ):
            if here != there:
                raise InputError(
                    f"{self.path} has {here} {what}, {neutral.path} has {there}: export both from one mesh, with vertex "
                    "order kept and nothing triangulated or split in only one of them"
                )
        if self.faces is not neutral.faces and not self.faces.same_as(neutral.faces):
            number = self.faces.first_difference(neutral.faces)
            ours, theirs = (" ".join(str(1 + corner) for corner in mesh.faces.face(number)) for mesh in (self, neutral))
            raise InputError(
                f"{self.path} and {neutral.path} both have {len(self.vertices)} vertices and {len(self.faces)} faces, but face "
                f"{number + 1} joins the vertices {ours} in the one and {theirs} in the other: their order differs; export "
                "both with vertex order kept"
            )


def read_sculpt(path: Path, like: Sculpt | None = None) -> Sculpt:
    """Read an OBJ or PLY file.

    Args:
        like: another mesh, whose faces are reused where they are equal byte for byte.

    Raises:
        InputError: it cannot be read, is truncated, holds no vertices, NaN or infinite coordinates, faces with fewer than
            three corners, or faces that use vertices which are not there.
    """
    file = read_mesh(path)
    if not len(file.points):
        raise InputError(f"{path}: no vertices in it: empty, truncated, or not a mesh; export it again")
    finite = np.isfinite(file.points).all(axis=1)
    if not finite.all():
        number = int(np.argmin(finite))
        raise InputError(
            f"{path}: {(~finite).sum()} vertices have NaN or infinite coordinates, the first is vertex {number + 1} of "
            f"{len(finite)}; export it again"
        )
    if like and type(file) is type(like.file) and file.face_bytes == like.file.face_bytes and len(finite) == len(like.vertices):
        return Sculpt(file, like.faces)
    faces = file.polygons() or Polygons.triangles(np.zeros((0, 3), np.int64))
    sizes, corners = faces.sizes, faces.corners
    if len(sizes) and sizes.min() < 3:
        raise InputError(
            f"{path}: face {int(np.argmax(sizes < 3)) + 1} has {sizes.min()} corners, expected at least 3: truncated, or "
            "damaged; export it again"
        )
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(finite):
        raise InputError(
            f"{path}: the faces use vertices {corners.min() + 1} to {corners.max() + 1}, the file has vertices 1 to "
            f"{len(finite)}: truncated, or damaged; export it again"
        )
    return Sculpt(file, faces)
