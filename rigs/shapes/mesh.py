"""A mesh as its file states it: vertices in the file's order, faces of any size. The one place that reads sculpted meshes.

General loaders merge, split and reorder vertices; a shape whose order differs from its neutral's is worthless. So the files
are read here, line by line, and nothing is done to what they say.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from riginv.errors import InputError
from rigs.shapes.obj import read_obj
from rigs.shapes.ply import read_ply

READERS = {".obj": read_obj, ".ply": read_ply}


@dataclass(frozen=True)
class PolygonMesh:
    """A mesh of polygons.

    Attributes:
        path: the file that it stands in.
        vertices: `(vertex, 3)`, in the file's unit.
        sizes: how many corners each face has, `(face,)`.
        corners: the vertex of each corner, face after face, `(corner,)`.
    """

    path: Path
    vertices: np.ndarray
    sizes: np.ndarray
    corners: np.ndarray

    def triangles(self) -> np.ndarray:
        """Every polygon as a fan around its first corner: `(triangle, 3)`."""
        starts = np.cumsum(self.sizes) - self.sizes
        first = np.repeat(starts, self.sizes - 2)
        step = np.concatenate([np.arange(1, size - 1) for size in self.sizes])
        return self.corners[np.stack([first, first + step, first + step + 1], axis=1)]

    def check_like(self, neutral: "PolygonMesh") -> None:
        """Raises InputError where this mesh does not have the neutral's vertices and faces, in its order."""
        for what, here, there in (
            ("vertices", len(self.vertices), len(neutral.vertices)),
            ("faces", len(self.sizes), len(neutral.sizes)),
        ):
            if here != there:
                raise InputError(
                    f"{self.path} has {here} {what}, {neutral.path} has {there}: export both from one mesh, with vertex "
                    "order kept and nothing triangulated or split in only one of them"
                )
        if not np.array_equal(self.sizes, neutral.sizes) or not np.array_equal(self.corners, neutral.corners):
            number = next(
                n for n, (ours, theirs) in enumerate(zip(self._faces(), neutral._faces())) if list(ours) != list(theirs)
            )
            ours, theirs = (" ".join(str(1 + corner) for corner in mesh._faces()[number]) for mesh in (self, neutral))
            raise InputError(
                f"{self.path} and {neutral.path} both have {len(self.vertices)} vertices and {len(self.sizes)} faces, but face "
                f"{number + 1} joins the vertices {ours} in the one and {theirs} in the other: their order differs; export "
                "both with vertex order kept"
            )

    def _faces(self) -> list[np.ndarray]:
        return np.split(self.corners, np.cumsum(self.sizes)[:-1])


def read_mesh(path: Path) -> PolygonMesh:
    """Read an OBJ or PLY file.

    Raises:
        InputError: it cannot be read, is truncated, holds no vertices, NaN or infinite coordinates, faces with fewer than
            three corners, or faces that use vertices which are not there.
    """
    try:
        vertices, sizes, corners = READERS[path.suffix.lower()](path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not len(vertices):
        raise InputError(f"{path}: no vertices in it: empty, truncated, or not a mesh; export it again")
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        number = int(np.argmin(finite))
        raise InputError(
            f"{path}: {(~finite).sum()} vertices have NaN or infinite coordinates, the first is vertex {number + 1} of "
            f"{len(vertices)}; export it again"
        )
    if len(sizes) and sizes.min() < 3:
        raise InputError(
            f"{path}: face {int(np.argmax(sizes < 3)) + 1} has {sizes.min()} corners, expected at least 3: truncated, or "
            "damaged; export it again"
        )
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
        raise InputError(
            f"{path}: the faces use vertices {corners.min() + 1} to {corners.max() + 1}, the file has vertices 1 to "
            f"{len(vertices)}: truncated, or damaged; export it again"
        )
    return PolygonMesh(path, vertices, sizes, corners)
