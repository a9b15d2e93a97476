"""USD: the points of a mesh at each time code (`pip install 'riginv[usd]'`)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from riginv.clips.files import opened
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.errors import InputError

MOST_FRAMES = 10_000_000


class UsdPoints(MeshSequence):
    """A mesh of a USD stage whose points have time samples, placed in the world.

    Args:
        path: the stage.
        mesh: the path or the name of its prim; None: the only one whose points move.

    Raises:
        InputError: usd-core is not installed, the stage cannot be opened, or no mesh, or more than one, could be meant.
    """

    def __init__(self, path: Path, mesh: str | None = None) -> None:
        try:
            from pxr import Tf, Usd, UsdGeom
        except ImportError:
            raise InputError(f"{path}: reading USD needs usd-core: pip install 'riginv[usd]'") from None
        with opened(path):
            pass
        self.geometry, self.error = UsdGeom, Tf.ErrorException
        with self._guarded(path):
            self.stage = Usd.Stage.Open(str(path))
            self.mesh = self._chosen(path, mesh)
            self.times = _times(path, self.mesh)
            points, faces = self._points(path, self.times[0]), self._polygons(path)
            rate = self.stage.GetTimeCodesPerSecond() if self.stage.HasAuthoredMetadata("timeCodesPerSecond") else None
            mm = UsdGeom.GetStageMetersPerUnit(self.stage) * 1000 if UsdGeom.StageHasAuthoredMetersPerUnit(self.stage) else None
            up = str(UsdGeom.GetStageUpAxis(self.stage)).lower() if self.stage.HasAuthoredMetadata("upAxis") else None
        step = float(np.diff(self.times).min()) if len(self.times) > 1 else 1.0
        numbers = np.round(np.array(self.times) / step)
        if np.abs(numbers).max() > MOST_FRAMES:
            raise InputError(
                f"{path}: time codes {self.times[0]:g} to {self.times[-1]:g}, {step:g} apart: damaged; export it again"
            )
        super().__init__(path, numbers.astype(np.int64), len(points), faces, rate / step if rate else None, mm, up)

    def read(self, start: int, stop: int) -> np.ndarray:
        with self._guarded(self.path):
            found = [self._points(self.path, time) for time in self.times[start:stop]]
        for time, points in zip(self.times[start:stop], found):
            if len(points) != self.vertex_count:
                raise InputError(
                    f"{self.path}: {len(points)} points at time code {time:g}, and {self.vertex_count} at first: all frames must be "
                    f"the same mesh; export it again"
                )
        return np.stack(found).astype(np.float32)

    @contextmanager
    def _guarded(self, path: str | Path) -> Iterator[None]:
        """Say in a sentence what USD says in many lines, some of them in bytes that are no text."""
        try:
            yield
        except UnicodeDecodeError:
            raise InputError(f"{path}: USD finds names in it that are no text: damaged; export it again") from None
        except (self.error, RuntimeError, ValueError, OverflowError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{path}: USD cannot read it: damaged, or no USD ({type(error).__name__}); export it again"
            ) from None

    def _chosen(self, path: Path, name: str | None) -> object:
        meshes = [self.geometry.Mesh(prim) for prim in self.stage.Traverse() if prim.IsA(self.geometry.Mesh)]
        named = {str(mesh.GetPath()): mesh for mesh in meshes}
        if name is not None:
            fitting = [mesh for place, mesh in named.items() if name in (place, place.rpartition("/")[2])]
        else:
            moving = [mesh for mesh in meshes if mesh.GetPointsAttr().GetNumTimeSamples() > 0]
            fitting = moving or meshes
        if len(fitting) != 1:
            listed = ", ".join(list(named)[:8]) or "none"
            asked = f"reading.mesh={name} names {len(fitting)} of them" if name else "say which with reading.mesh=PATH"
            raise InputError(f"{path}: expected one mesh, {asked}; its meshes are: {listed}")
        return fitting[0]

    def _points(self, path: str | Path, time: float) -> np.ndarray:
        points = self.mesh.GetPointsAttr().Get(time)
        placed = np.array(self.geometry.XformCache(time).GetLocalToWorldTransform(self.mesh.GetPrim()), np.float64)
        if points is None or not len(points):
            raise InputError(f"{path}: no points at time code {time:g}: export it again")
        with np.errstate(over="ignore", invalid="ignore"):
            return np.array(points, np.float64) @ placed[:3, :3] + placed[3, :3]

    def _polygons(self, path: Path) -> Polygons | None:
        sizes, corners = (
            attribute.Get(self.times[0])
            for attribute in (self.mesh.GetFaceVertexCountsAttr(), self.mesh.GetFaceVertexIndicesAttr())
        )
        if not sizes:
            return None
        found = Polygons(np.array(sizes, np.int64), np.array(corners or [], np.int64))
        if (found.sizes < 0).any() or found.sizes.sum() != len(found.corners):
            raise InputError(
                f"{path}: its faces need {found.sizes.sum()} corners and have {len(found.corners)}: export it again"
            )
        return found


def _times(path: Path, mesh: object) -> list[float]:
    times = [float(time) for time in mesh.GetPointsAttr().GetTimeSamples()] or [0.0]
    if len(times) > MOST_FRAMES or not np.isfinite(times).all():
        raise InputError(f"{path}: {len(times)} time samples, not all of them numbers: damaged; export it again")
    return times
