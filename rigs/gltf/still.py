"""The meshes of a glTF file as they are without an animation, such as those of a scan."""

from pathlib import Path

import numpy as np

from riginv.meshes.mesh_file import MeshFile
from riginv.meshes.polygons import Polygons
from rigs.gltf.container import UNIT_MM, open_gltf
from rigs.gltf.posing import PosedMeshes
from rigs.gltf.scene import read_scene
from rigs.gltf.selection import mesh_nodes


class GltfMesh(MeshFile):
    """All meshes in the scene of a .glb or .gltf, in the world; its objects are the nodes of the meshes.

    Raises:
        InputError: the file cannot be read, or holds no triangles.
    """

    unit_mm, up = UNIT_MM, "y"

    def __init__(self, path: Path) -> None:
        file = open_gltf(str(path))
        scene = read_scene(file)
        meshes = PosedMeshes(file, scene, mesh_nodes(file, scene))
        self._faces = meshes.faces() if meshes.submeshes else np.zeros((0, 3), np.int64)
        self._vertices: dict[str, list[np.ndarray]] = {}
        for submesh in meshes.submeshes:
            own = np.arange(submesh.start, submesh.start + submesh.count)
            self._vertices.setdefault(scene.names[submesh.node], []).append(own)
        super().__init__(path, meshes.vertices({}), self._faces.tobytes(), tuple(file.notes))

    @property
    def objects(self) -> tuple[str, ...]:
        return tuple(self._vertices)

    def vertices_of(self, name: str) -> np.ndarray:
        return np.concatenate(self._vertices[name])

    def polygons(self) -> Polygons:
        return Polygons.triangles(self._faces)
