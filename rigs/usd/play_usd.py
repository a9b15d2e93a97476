"""Plays the points of a mesh of a USD stage for another process, frame by frame (docs/worker-protocol.md).

PYTHON play_usd.py
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom

sys.path.insert(0, str(Path(__file__).parents[1] / "blender" / "in_blender"))  # the worker's own code needs no riginv
from worker import RefusedError, serve

Answer = tuple[dict[str, Any], dict[str, np.ndarray]]
MOST_FRAMES = 10_000_000
MOST_LAYERS = 1000
MEMORY = 4 << 30  # bytes that a stage may take beyond MEMORY_SHARE times its file: more is damage
MEMORY_SHARE = 20


class UsdScene:
    """Loads a stage, describes it, and evaluates frames of it: its `controls` are places among the time samples."""

    def load(self, file: str, mesh: str | None = None) -> Answer:
        """Open the stage and choose its mesh."""
        limit_memory(MEMORY + MEMORY_SHARE * Path(file).stat().st_size)
        self.file = file
        try:
            refuse_layers_elsewhere(file)
            self.stage = Usd.Stage.Open(file)
            self.mesh = self.chosen(mesh)
            self.times = [float(time) for time in self.mesh.GetPointsAttr().GetTimeSamples()] or [0.0]
        except (Tf.ErrorException, RuntimeError, ValueError, MemoryError) as error:
            raise RefusedError(
                f"{file}: USD cannot open it ({type(error).__name__}): damaged, or no USD; export it again"
            ) from None
        if len(self.times) > MOST_FRAMES or not np.isfinite(self.times).all():
            raise RefusedError(f"{file}: {len(self.times)} time samples, not all of them numbers: damaged; export it again")
        return {"mesh": str(self.mesh.GetPath())}, {}

    def describe(self) -> Answer:
        """Time codes and faces; time codes a second, mm to a unit and the axis that is up, where the stage says them."""
        try:
            stage, first = self.stage, self.frame(0)
            rate = stage.GetTimeCodesPerSecond() if stage.HasAuthoredMetadata("timeCodesPerSecond") else None
            mm = UsdGeom.GetStageMetersPerUnit(stage) * 1000 if UsdGeom.StageHasAuthoredMetersPerUnit(stage) else None
            up = str(UsdGeom.GetStageUpAxis(stage)).lower() if stage.HasAuthoredMetadata("upAxis") else None
            found = [
                np.array(attribute.Get(self.times[0]) or [], np.int64)
                for attribute in (self.mesh.GetFaceVertexCountsAttr(), self.mesh.GetFaceVertexIndicesAttr())
            ]
        except (Tf.ErrorException, RuntimeError, ValueError, MemoryError) as error:
            raise RefusedError(f"{self.file}: USD cannot read it ({type(error).__name__}): damaged; export it again") from None
        facts = {"vertices": len(first), "rate": rate, "unit_mm": mm, "up": up}
        return facts, {"times": np.array(self.times), "sizes": found[0], "corners": found[1]}

    def evaluate(self, names: list[str], controls: np.ndarray) -> Answer:
        """The points of frames."""
        places = controls[:, names.index("frame")].astype(np.int64).tolist()
        try:
            found = [self.frame(place) for place in places]
        except (Tf.ErrorException, RuntimeError, ValueError, MemoryError) as error:
            raise RefusedError(f"{self.file}: USD cannot read it ({type(error).__name__}): damaged; export it again") from None
        for place, points in zip(places, found):
            if len(points) != len(found[0]):
                raise RefusedError(
                    f"{self.file}: {len(points)} points at time code {self.times[place]:g} and {len(found[0])} before: all "
                    f"frames must be the same mesh; export it again"
                )
        return {}, {"vertices": np.stack(found)}

    def chosen(self, name: str | None) -> UsdGeom.Mesh:
        """The named mesh, or the only one whose points move, or the only one."""
        named = {str(prim.GetPath()): UsdGeom.Mesh(prim) for prim in self.stage.Traverse() if prim.IsA(UsdGeom.Mesh)}
        if name is not None:
            fitting = [mesh for place, mesh in named.items() if name in (place, place.rpartition("/")[2])]
        else:
            moving = [mesh for mesh in named.values() if mesh.GetPointsAttr().GetNumTimeSamples() > 0]
            fitting = moving or list(named.values())
        if len(fitting) != 1:
            listed = ", ".join(list(named)[:8]) or "none"
            asked = f"reading.mesh={name} names {len(fitting)} of them" if name else "say which with reading.mesh=PATH"
            raise RefusedError(f"{self.file}: expected one mesh, {asked}; its meshes are: {listed}")
        return fitting[0]

    def frame(self, place: int) -> np.ndarray:
        """The points `(vertex, 3)` of a time sample in the world, float32."""
        time = self.times[place]
        points = self.mesh.GetPointsAttr().Get(time)
        if points is None or not len(points):
            raise RefusedError(f"{self.file}: no points at time code {time:g}: export it again")
        placed = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(self.mesh.GetPrim()), np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            return (np.array(points, np.float64) @ placed[:3, :3] + placed[3, :3]).astype(np.float32)


def refuse_layers_elsewhere(file: str) -> None:
    """Other layers that a stage is composed of lie in its own folder; none is fetched, and no device or pipe is opened."""
    folder = Path(file).resolve().parent
    waiting, seen = [Path(file).resolve()], set()
    while waiting:
        path = waiting.pop()
        seen.add(path)
        if len(seen) > MOST_LAYERS:
            raise RefusedError(f"{file}: made of more than {MOST_LAYERS} layers: flatten it with usdcat --flatten")
        layer = Sdf.Layer.FindOrOpen(str(path))
        for asset in assets_of(layer) if layer else ():
            name = asset.partition(":SDF_FORMAT_ARGS:")[0].partition("[")[0]
            target = (path.parent / name).resolve() if "\0" not in name else folder.parent
            if ":" in name or not target.is_relative_to(folder) or (target.exists() and not target.is_file()):
                raise RefusedError(
                    f"{file}: it refers to {asset[:80]!r}, expected layers in its own folder: flatten it with usdcat --flatten"
                )
            if target.is_file() and target not in seen:
                waiting.append(target)


def assets_of(layer: Sdf.Layer) -> list[str]:
    """What a layer is composed of: sublayers, references, payloads and value clips, as it writes them."""
    found = list(layer.GetCompositionAssetDependencies())

    def visit(path: Sdf.Path) -> None:
        spec = layer.GetObjectAtPath(path)
        if isinstance(spec, Sdf.PrimSpec) and spec.HasInfo("clips"):
            found.extend(paths_in(spec.GetInfo("clips")))

    layer.Traverse(Sdf.Path.absoluteRootPath, visit)
    return [asset for asset in found if asset]


def paths_in(value: Any) -> list[str]:
    """The asset paths in the metadata of value clips."""
    if isinstance(value, Sdf.AssetPath):
        return [value.path]
    if isinstance(value, dict):
        return [path for inner in value.values() for path in paths_in(inner)]
    if isinstance(value, list | tuple | Sdf.AssetPathArray):
        return [path for inner in value for path in paths_in(inner)]
    return []


def limit_memory(most: int) -> None:
    """On systems that can: what asks for more than that fails, and does not take the machine with it."""
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    serve(UsdScene())
