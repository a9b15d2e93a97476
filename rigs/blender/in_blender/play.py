"""Runs inside Blender's Python: a worker that evaluates frames of an Alembic or FBX file (docs/worker-protocol.md).

PYTHON play.py     or     blender --background --factory-startup --python play.py
"""

import os
import sys
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))  # Blender does not add it
from clip_frames import alembic_frames, archive_rate, fbx_frames, set_rate
from mesh_choice import joined, listing
from scene_meshes import SceneMesh, SceneMeshes, faces, go_to
from takes import Take, import_takes
from worker import RefusedError, RefusedScansError, serve

Answer = tuple[dict[str, Any], dict[str, np.ndarray]]
METRE = 1000.0  # mm
FAILURES = (RuntimeError, ValueError, TypeError, KeyError, IndexError, AttributeError, AssertionError, OverflowError)


class ClipScene:
    """Loads a clip, describes it, and evaluates frames of it: its `controls` are indices of frames."""

    def load(
        self,
        file: str,
        meshes: list[str] | None = None,
        animation: str | int | None = None,
        fps: float | None = None,
        vertices: int | None = None,
        ragged: bool = False,
    ) -> Answer:
        """Import the file into an empty scene, and choose its meshes.

        Args:
            file: an .abc or .fbx.
            meshes: names; none: see `choose_meshes`.
            animation: name or number of a take of an FBX; None: the first that moves the meshes.
            fps: frames a second to play it at; None: the file's own.
            vertices: of the rig that the clip is for, where known.
            ragged: whether each frame may be another mesh.
        """
        self.ragged = ragged
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.file, self.is_fbx, self.notes = file, file.lower().endswith(".fbx"), []
        self.takes: list[Take] = []
        try:
            if self.is_fbx:
                self.takes = import_takes(file)
            else:
                set_rate(archive_rate(file, fps))
                bpy.ops.wm.alembic_import(filepath=file, as_background_job=False)
        except FAILURES as error:
            raise RefusedError(f"{file}: Blender cannot import it: {' '.join(str(error).split())[:200]}") from None
        render = bpy.context.scene.render
        self.clock = render.fps if self.is_fbx else render.fps / render.fps_base  # FBX keys stand at whole rates, 29.97 as 30
        scene = SceneMeshes(file)
        moving = self.choose_take(scene, meshes or [], animation, fps)
        self.meshes = scene.chosen(meshes or [], vertices, moving, self.notes)
        self.other_meshes = [mesh.path for mesh in scene.all if mesh not in self.meshes]
        return {"mesh": self.meshes[0].path}, {}

    def choose_take(
        self, scene: SceneMeshes, names: list[str], animation: str | int | None, fps: float | None
    ) -> list[SceneMesh]:
        """Choose the take and its frames.

        Returns:
            The meshes that move in it, of those with these names or of all.
        """
        if not self.is_fbx:
            if animation is not None:
                raise RefusedError(
                    f"{self.file}: an Alembic file has no animations to choose from: leave reading.animation out"
                )
            self.take, self.frames = None, alembic_frames(self.file, fps)
            return scene.moving(names, self.frames.seconds * self.clock)
        takes = self.takes if animation is None else [self.requested_take(animation)]
        self.take, self.frames = None, fbx_frames(self.file, None, fps)
        for take in takes:
            take.play()
            frames = fbx_frames(self.file, take, fps)
            moving = scene.moving(names, frames.seconds * self.clock)
            if self.take is None or moving:
                self.take, self.frames = take, frames
            if moving:
                return moving
        if self.take:
            self.take.play()
            self.notes.append(f"No animation moves the mesh: '{self.take.name}' was read.")
        return []

    def requested_take(self, requested: str | int) -> Take:
        """The take with a name, in full or behind its `|`, or with a number from 1."""
        fitting = [take for take in self.takes if take.name == str(requested)]
        fitting = fitting or [take for take in self.takes if take.name.rpartition("|")[2] == str(requested)]
        if not fitting and str(requested).isdecimal() and 1 <= int(requested) <= len(self.takes):
            fitting = [self.takes[int(requested) - 1]]
        if len(fitting) != 1:
            listed = listing([f"'{take.name}'" for take in self.takes])
            raise RefusedError(f"{self.file}: reading.animation={requested} names {len(fitting)} animations; it has {listed}")
        return fitting[0]

    def describe(self) -> Answer:
        """Frames and faces, what was read and left out; frames a second and mm to a unit, where the file states them."""
        self.frame(0)
        sizes, corners = faces(self.meshes)
        facts = {
            "meshes": [mesh.path for mesh in self.meshes],
            "other_meshes": self.other_meshes,
            "animation": self.take.name if self.take else "",
            "other_animations": [take.name for take in self.takes if take is not self.take],
            "rate_source": self.frames.source,
            "notes": [*self.notes, *self.frames.notes],
            "vertices": sum(mesh.vertex_count for mesh in self.meshes),
            "fps": self.frames.fps or None,
            "unit_mm": METRE if self.is_fbx else None,
            "up": "y",
        }
        return facts, {"frames": self.frames.numbers, "sizes": sizes, "corners": corners}

    def evaluate(self, names: list[str], controls: np.ndarray) -> Answer:
        """The vertices of frames; of a ragged clip of one frame, with its faces."""
        indices = controls[:, names.index("frame")].astype(np.int64).tolist()
        if self.ragged:
            go_to(self.frames.seconds[indices[0]] * self.clock)
            points, shapes = zip(*(mesh.evaluated() for mesh in self.meshes))
            sizes, corners = joined(shapes, [len(found) for found in points])
            return {}, {"vertices": np.concatenate(points)[None], "sizes": sizes, "corners": corners}
        return {}, {"vertices": np.stack([self.frame(index) for index in indices])}

    def frame(self, index: int) -> np.ndarray:
        """The vertices `(vertex, 3)` of a frame in the world, y up, in Blender's units; mesh after mesh."""
        go_to(self.frames.seconds[index] * self.clock)
        points = [mesh.world_points() for mesh in self.meshes]
        for mesh, found in zip(self.meshes, points):
            if len(found) != mesh.vertex_count and not self.ragged:
                raise RefusedScansError(
                    f"{self.file}: {len(found)} vertices of '{mesh.path}' in frame {self.frames.numbers[index]}, "
                    f"{mesh.vertex_count} at first: all frames must be the same mesh: export it again, or "
                    f"correspondence=surface fits each as a scan"
                )
        return np.concatenate(points)


if __name__ == "__main__":
    serve(ClipScene())
