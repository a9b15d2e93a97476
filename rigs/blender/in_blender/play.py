"""Runs inside Blender's Python: plays an Alembic or FBX file for another process, frame by frame (docs/worker-protocol.md).

PYTHON play.py     or     blender --background --factory-startup --python play.py
"""

import math
import os
import sys
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # Blender does not add it
from worker import RefusedError, serve

Answer = tuple[dict[str, Any], dict[str, np.ndarray]]
MOST_FRAMES = 10_000_000
METRE = 1000.0  # mm


class ClipScene:
    """Loads a clip, describes it, and evaluates frames of it: its `controls` are frame numbers."""

    def load(self, file: str, mesh: str | None = None, fps: float = 30.0) -> Answer:
        """Import the file into an empty scene, and choose its mesh."""
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene, is_fbx = bpy.context.scene, file.lower().endswith(".fbx")
        scene.render.fps, scene.render.fps_base = max(1, round(fps)), max(1, round(fps)) / fps
        try:
            if is_fbx:
                if not hasattr(bpy.ops.import_scene, "fbx") or "io_scene_fbx" not in bpy.context.preferences.addons:
                    bpy.ops.preferences.addon_enable(module="io_scene_fbx")
                bpy.ops.import_scene.fbx(filepath=file, anim_offset=0.0, use_image_search=False)
            else:
                bpy.ops.wm.alembic_import(filepath=file, as_background_job=False)
        except (
            RuntimeError,
            ValueError,
            TypeError,
            KeyError,
            IndexError,
            AttributeError,
            AssertionError,
            OverflowError,
        ) as error:
            raise RefusedError(f"{file}: Blender cannot import it: {' '.join(str(error).split())[:200]}") from None
        self.file, self.mesh = file, chosen(file, mesh)
        self.mesh.hide_viewport = False
        self.mesh.hide_set(False)
        self.unit_mm = METRE if is_fbx else 0.0
        self.fps = scene.render.fps / scene.render.fps_base if is_fbx else 0.0
        first, last = keyed_range() if is_fbx else (scene.frame_start, scene.frame_end)
        if last - first > MOST_FRAMES:
            raise RefusedError(f"{file}: frames {first} to {last} are more than can be meant: damaged? export it again")
        self.frames = np.arange(first, last + 1)
        return {"mesh": self.mesh.name}, {}

    def describe(self) -> Answer:
        """Frame numbers and faces; frames a second and mm to a unit, 0 where the file does not say."""
        vertices, mesh = self.frame(float(self.frames[0])), self.mesh.data
        sizes, corners = np.empty(len(mesh.polygons), np.int32), np.empty(len(mesh.loops), np.int32)
        mesh.polygons.foreach_get("loop_total", sizes)
        mesh.loops.foreach_get("vertex_index", corners)
        facts = {"mesh": self.mesh.name, "vertices": len(vertices), "fps": self.fps, "unit_mm": self.unit_mm}
        return facts, {"frames": self.frames, "sizes": sizes, "corners": corners}

    def evaluate(self, names: list[str], controls: np.ndarray) -> Answer:
        """The vertices of frames."""
        return {}, {"vertices": np.stack([self.frame(float(frame)) for frame in controls[:, names.index("frame")]])}

    def frame(self, number: float) -> np.ndarray:
        """The vertices `(vertex, 3)` of a frame in the world, y up, in Blender's units."""
        bpy.context.scene.frame_set(math.floor(number))
        evaluated = self.mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
        mesh = evaluated.to_mesh()
        vertices = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("co", vertices)
        evaluated.to_mesh_clear()
        world = np.array(evaluated.matrix_world, np.float64)
        x, y, z = (vertices.reshape(-1, 3).astype(np.float64) @ world[:3, :3].T + world[:3, 3]).T
        return np.stack([x, z, -y], axis=1).astype(np.float32)


def chosen(file: str, name: str | None) -> bpy.types.Object:
    """The named mesh object, or the only one there is."""
    meshes = {thing.name: thing for thing in bpy.data.objects if thing.type == "MESH"}
    listed = ", ".join(f"'{other}'" for other in list(meshes)[:12]) or "none"
    if name is not None and name not in meshes:
        raise RefusedError(f"{file}: there is no mesh '{name}'; it has {listed}")
    if name is None and len(meshes) != 1:
        raise RefusedError(f"{file}: expected one mesh, say which with reading.mesh=NAME; its meshes are: {listed}")
    return meshes[name] if name is not None else next(iter(meshes.values()))


def keyed_range() -> tuple[int, int]:
    """The first and the last frame that any action has a key at."""
    ranges = [action.frame_range for action in bpy.data.actions]
    if not ranges:
        return 0, 0
    return math.floor(min(one[0] for one in ranges)), math.ceil(max(one[1] for one in ranges))


if __name__ == "__main__":
    serve(ClipScene())
