"""A worker that evaluates frames of a USD stage (docs/worker-protocol.md).

PYTHON play_usd.py
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Tf, Usd, UsdGeom

sys.path.insert(0, str(Path(__file__).parents[2]))  # where `rigs` is; the worker's own code needs no riginv

from rigs.blender.in_blender.mesh_choice import joined, listing
from rigs.blender.in_blender.worker import RefusedError, RefusedScansError, serve
from rigs.usd.choice import StageContents, all_prims, chosen_meshes
from rigs.usd.frame_grid import frame_grid
from rigs.usd.layers import limit_memory, refuse_layers_elsewhere
from rigs.usd.skins import repair_bindings
from rigs.usd.stage_clock import StageClock, UnusableStageError
from rigs.usd.stage_facts import animations, faces, notes_of_skins, notes_of_variants, notes_of_visibility

Answer = tuple[dict[str, Any], dict[str, np.ndarray]]
MEMORY = 4 << 30  # limit in bytes
MEMORY_PER_BYTE = 20  # additional limit per byte of the file
MOST_NAMED = 1000  # meshes and animations named to the user
NO_FACES = np.zeros(0, np.int64), np.zeros(0, np.int64)
DAMAGED = (Tf.ErrorException, Tf.CppException, RuntimeError, ValueError, TypeError, MemoryError)


class OpenedStage:
    """A stage that is opened with limits, and its metadata.

    Args:
        memory: limit in bytes beyond MEMORY_PER_BYTE times the size of the file; None: unlimited.
    """

    def __init__(self, memory: int | None = None) -> None:
        self.memory = memory

    def open(self, file: str, ragged: bool = False) -> None:
        """Open the stage, repair its bindings, and list its contents."""
        if self.memory is not None:
            limit_memory(self.memory + MEMORY_PER_BYTE * Path(file).stat().st_size)
        self.file = file
        self.notes: list[str] = []
        with self.refusing("open"):
            missing = refuse_layers_elsewhere(file)
            if missing:
                self.notes.append(f"Layers that it refers to are not there: {listing(missing)}.")
            self.stage = Usd.Stage.Open(file)
            self.notes += repair_bindings(self.stage, all_prims(self.stage))
            self.contents = StageContents(self.stage, all_prims(self.stage), ragged)

    def clock(self, requested: float | None) -> StageClock:
        """Time metadata of the stage."""
        stage = self.stage
        rates = {
            "time_codes_per_second": stage.GetTimeCodesPerSecond() if stage.HasAuthoredMetadata("timeCodesPerSecond") else None,
            "frames_per_second": stage.GetFramesPerSecond() if stage.HasAuthoredMetadata("framesPerSecond") else None,
        }
        if not stage.HasAuthoredTimeCodeRange():
            return StageClock(**rates, requested=requested)
        return StageClock(**rates, start=stage.GetStartTimeCode(), end=stage.GetEndTimeCode(), requested=requested)

    def units(self) -> dict[str, Any]:
        """Millimetres per unit and the up axis, None where not authored."""
        stage = self.stage
        mm = UsdGeom.GetStageMetersPerUnit(stage) * 1000 if UsdGeom.StageHasAuthoredMetersPerUnit(stage) else None
        return {
            "unit_mm": mm,
            "up": str(UsdGeom.GetStageUpAxis(stage)).lower() if stage.HasAuthoredMetadata("upAxis") else None,
        }

    @contextmanager
    def refusing(self, what: str) -> Iterator[None]:
        """Convert errors to refusals that name the file."""
        try:
            yield
        except UnusableStageError as error:
            refused = RefusedScansError if error.are_scans else RefusedError
            raise refused(f"{self.file}: {error}", error.meshes) from None
        except DAMAGED as error:
            raise RefusedError(
                f"{self.file}: USD cannot {what} it ({type(error).__name__}): damaged, or no USD; export it again"
            ) from None


class UsdScene(OpenedStage):
    """Loads a stage, describes it, and evaluates frames of it: its `controls` are indices of frames."""

    def load(
        self,
        file: str,
        meshes: list[str] | None = None,
        animation: str | int | None = None,
        fps: float | None = None,
        vertices: int | None = None,
        ragged: bool = False,
    ) -> Answer:
        """Open the stage and choose its meshes.

        Args:
            file: the stage.
            meshes: names or paths; none: see `chosen_meshes`.
            animation: path, name or number of the SkelAnimation to bind; None: what the stage binds.
            fps: requested frame rate.
            vertices: of the rig that the clip is for, where known.
            ragged: whether each frame may be another mesh.
        """
        self.open(file, ragged)
        with self.refusing("open"):
            if not self.contents.mesh_paths:
                raise self.contents.without_meshes(self.notes)
            if animation is not None:
                self.contents.bind_animation(animation)
            self.meshes = chosen_meshes(self.contents, meshes or [], vertices, self.notes)
            held = ragged and any(mesh.changes() for mesh in self.meshes)
            if held:
                self.stage.SetInterpolationType(Usd.InterpolationTypeHeld)  # nothing lies between two meshes
            times = np.unique(np.concatenate([mesh.times for mesh in self.meshes]))
            self.grid = frame_grid(times, self.clock(fps), held)
        return {"mesh": self.meshes[0].path}, {}

    def describe(self) -> Answer:
        """Frames, faces, what was read and left out, and the units and up axis, where the stage states them."""
        stage, meshes, grid = self.stage, self.meshes, self.grid
        with self.refusing("read"):
            self.frame(0)
            read, others = animations(self.contents, meshes)
            sizes, corners = faces(meshes)
            paths = [mesh.path for mesh in meshes]
            notes = [*self.notes, *grid.notes, *notes_of_skins(meshes, others)]
            notes += [*notes_of_visibility(meshes, grid.times), *notes_of_variants(stage, meshes)]
        facts = {
            "meshes": paths,
            "other_meshes": [str(path) for path in self.contents.mesh_paths if str(path) not in paths][:MOST_NAMED],
            "animation": ", ".join(read),
            "other_animations": others[:MOST_NAMED],
            "fps": grid.fps,
            "rate_source": grid.source,
            "notes": notes,
            "vertices": sum(mesh.vertex_count for mesh in meshes),
            **self.units(),
        }
        return facts, {"frames": grid.numbers, "sizes": sizes, "corners": corners}

    def evaluate(self, names: list[str], controls: np.ndarray) -> Answer:
        """The vertices of frames; of a ragged clip of one frame, with its faces."""
        indices = controls[:, names.index("frame")].astype(np.int64).tolist()
        with self.refusing("read"):
            if not self.contents.ragged:
                return {}, {"vertices": np.stack([np.concatenate(self.frame(index)) for index in indices])}
            points, time = self.frame(indices[0]), float(self.grid.times[indices[0]])
            shapes = [mesh.faces(time) if len(found) else NO_FACES for mesh, found in zip(self.meshes, points)]
            sizes, corners = joined(shapes, [len(found) for found in points])
        return {}, {"vertices": np.concatenate(points)[None], "sizes": sizes, "corners": corners}

    def frame(self, index: int) -> list[np.ndarray]:
        """The points `(vertex, 3)` of each mesh in the world, float32, in a frame."""
        time = float(self.grid.times[index])
        transforms = UsdGeom.XformCache(time)
        with np.errstate(over="ignore"):
            return [mesh.world_points(time, transforms).astype(np.float32) for mesh in self.meshes]


if __name__ == "__main__":
    serve(UsdScene(MEMORY))
