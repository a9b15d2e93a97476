"""Inside Blender: meshes of an imported scene in world space, and their selection."""

import bpy
import numpy as np
from mesh_choice import MOST_LISTED, Faces, choose_meshes, joined, listing, unclear
from worker import RefusedError

LAST_FRAME = 1_048_574  # Blender's greatest frame number
LOOKS = 24  # sampled frames to detect motion


class SceneMesh:
    """A mesh object.

    Args:
        thing: the object; it is made visible, since Blender does not evaluate what is hidden.
    """

    def __init__(self, thing: bpy.types.Object) -> None:
        thing.hide_viewport = False
        thing.hide_set(False)
        self.thing, self.path = thing, thing.name
        self.vertex_count = len(self.world_points())

    def world_points(self) -> np.ndarray:
        """The vertices `(vertex, 3)` in the world at the present frame, y up, in Blender's units."""
        return self.evaluated(False)[0]

    def evaluated(self, with_faces: bool = True) -> tuple[np.ndarray, Faces]:
        """As `world_points`, and its faces at the present frame, or none."""
        evaluated = self.thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        vertices = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", vertices)
        faces = _faces_of(mesh) if with_faces else (np.empty(0, np.int32), np.empty(0, np.int32))
        evaluated.to_mesh_clear()
        world = np.array(evaluated.matrix_world, np.float64)
        x, y, z = (vertices.reshape(-1, 3).astype(np.float64) @ world[:3, :3].T + world[:3, 3]).T
        return np.stack([x, z, -y], axis=1).astype(np.float32), faces


class SceneMeshes:
    """All meshes of the scene.

    Args:
        file: what messages name.
    """

    def __init__(self, file: str) -> None:
        self.file, self.frame_count = file, 1
        self.all = [SceneMesh(thing) for thing in bpy.data.objects if thing.type == "MESH"]

    def named(self, names: list[str]) -> list[SceneMesh]:
        """The meshes with these names, in the order of the scene.

        Raises:
            RefusedError: there is none of a name.
        """
        known = [mesh.path for mesh in self.all]
        for name in names:
            if name not in known:
                listed = listing([f"'{other}'" for other in known])
                raise RefusedError(f"{self.file}: there is no mesh '{name}'; it has {listed}")
        return [mesh for mesh in self.all if mesh.path in names]

    def moving(self, names: list[str], frames: np.ndarray) -> list[SceneMesh]:
        """The named meshes, or without names all, that differ between some of Blender's frames."""
        candidates, self.frame_count = self.named(names) if names else self.all, len(frames)
        first: dict[str, np.ndarray] = {}
        moving: set[str] = set()
        for index in np.unique(np.linspace(0, len(frames) - 1, LOOKS).astype(int)).tolist():
            go_to(frames[index])
            for mesh in candidates:
                if mesh.path not in moving:
                    points = mesh.world_points()
                    if not np.array_equal(points, first.setdefault(mesh.path, points)):
                        moving.add(mesh.path)
            if len(moving) == len(candidates):
                break
        return [mesh for mesh in candidates if mesh.path in moving]

    def chosen(self, names: list[str], vertices: int | None, moving: list[SceneMesh], notes: list[str]) -> list[SceneMesh]:
        """The named meshes, or those that are meant: see `choose_meshes`.

        Raises:
            RefusedError: there is none of a name, or it is not clear which are meant.
        """
        if names:
            return self.named(names)
        found = choose_meshes(self.all, moving, vertices, notes)
        if not found:
            listed = [(mesh.path, mesh.vertex_count, self.frame_count if mesh in moving else 1) for mesh in self.all]
            raise RefusedError(f"{self.file}: {unclear(self.all, moving)}", listed[:MOST_LISTED])
        return found


def go_to(frame: float) -> None:
    """Bring the scene to a frame of Blender's, or between two."""
    if not abs(frame) <= LAST_FRAME:
        raise RefusedError(f"frame {frame:g} lies beyond what Blender can go to, {LAST_FRAME}: let its times start at 0")
    whole = np.round(frame) if abs(frame - np.round(frame)) < 1e-4 else np.floor(frame)
    bpy.context.scene.frame_set(int(whole), subframe=max(0.0, float(frame - whole)))


def faces(meshes: list[SceneMesh]) -> Faces:
    """Corners of each face, and the vertices at them, of all meshes as one."""
    return joined([_faces_of(mesh.thing.data) for mesh in meshes], [mesh.vertex_count for mesh in meshes])


def _faces_of(data: bpy.types.Mesh) -> Faces:
    sizes, corners = np.empty(len(data.polygons), np.int32), np.empty(len(data.loops), np.int32)
    data.polygons.foreach_get("loop_total", sizes)
    data.loops.foreach_get("vertex_index", corners)
    return sizes, corners
