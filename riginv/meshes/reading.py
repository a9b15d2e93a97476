"""Read a mesh from a file, by its extension."""

from collections.abc import Callable, Mapping
from pathlib import Path

from riginv.meshes.mesh_file import MeshFile
from riginv.meshes.obj import ObjMesh
from riginv.meshes.ply import PlyMesh
from riginv.runs.files import read_bytes

READERS: Mapping[str, Callable[[Path, bytes], MeshFile]] = {".obj": ObjMesh, ".ply": PlyMesh}


def read_mesh(path: Path) -> MeshFile:
    """Read an OBJ or PLY file.

    Raises:
        InputError: it is missing, cannot be read, or is damaged.
    """
    return READERS[path.suffix.lower()](path, read_bytes(path))
