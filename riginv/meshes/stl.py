"""STL files, in text or binary: triangles that share no vertices, as scanners write them."""

import io
from pathlib import Path

import numpy as np

from riginv.errors import InputError, in_short
from riginv.meshes.mesh_file import MeshFile
from riginv.meshes.polygons import Polygons

HEADER = 84  # bytes before the triangles of a binary file; the last four are their number
TRIANGLE = 50  # bytes of one


class StlMesh(MeshFile):
    """The triangles of an STL file; each has three points of its own, in the file's order.

    Args:
        path: of the file.
        data: its bytes.

    Raises:
        InputError: it is no STL, or damaged.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        from trimesh.exchange.stl import load_stl  # takes long to import

        text = data[:HEADER].lstrip().lower().startswith(b"solid") and b"\0" not in data[:HEADER]  # some binary files begin so
        count = int.from_bytes(data[HEADER - 4 : HEADER], "little")
        if not text and (len(data) < HEADER or len(data) < HEADER + TRIANGLE * count):
            held = max(0, len(data) - HEADER) // TRIANGLE
            raise InputError(f"{path}: {held} triangles, its header promises {count}: no STL, or cut short; export it again")
        try:
            corners = np.asarray(load_stl(io.BytesIO(data))["vertices"], np.float64).reshape(-1, 3)
        except Exception as error:  # the library's errors for damaged files have no common class
            raise InputError(f"{path}: no STL, or a damaged one ({in_short(error)}): export it again") from None
        if not len(corners):
            raise InputError(f"{path}: no triangles in it; expected a mesh: export it again")
        super().__init__(path, corners, b"")

    def polygons(self) -> Polygons:
        return Polygons.triangles(np.arange(len(self.points)).reshape(-1, 3))
