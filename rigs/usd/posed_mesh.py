"""Meshes of a stage, evaluated at a time: points, blend shapes, skin and world transform."""

from collections.abc import Iterable

import numpy as np
from pxr import Usd, UsdGeom, Vt

from rigs.usd.skins import Skin
from rigs.usd.stage_clock import MOST_FRAMES, UnusableAsClipError, UnusableStageError

LOOKS = 64  # sampled times to detect motion
ONE_TOPOLOGY = "all frames must be the same mesh: export it again, or correspondence=surface fits each as a scan"


class PosedMesh:
    """A mesh with its skin.

    Args:
        prim: the mesh.
        skin: None: unskinned.
        ragged: whether its points and faces may change from frame to frame, as those of scans.
    """

    def __init__(self, prim: Usd.Prim, skin: Skin | None, ragged: bool = False) -> None:
        self.prim, self.skin, self.path, self.ragged = prim, skin, str(prim.GetPath()), ragged
        mesh = UsdGeom.Mesh(prim)
        self._points = UsdGeom.PointBased(prim).GetPointsAttr()
        self._shape = (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        self._placed = skin.placed if skin and skin.has_joints else prim  # whose transform applies
        self._rest = self._points.Get() if skin else None  # UsdSkel ignores time samples of the points
        self.times = self._sample_times()
        self.vertex_count = len(self._points_at(self.first_time) or [])
        self._topology = [(attribute, attribute.Get(self.first_time)) for attribute in self._shape if _varies(attribute)]

    @property
    def first_time(self) -> float | Usd.TimeCode:
        return float(self.times[0]) if len(self.times) else Usd.TimeCode.EarliestTime()

    def world_points(self, time: float, transforms: UsdGeom.XformCache) -> np.ndarray:
        """Points `(vertex, 3)` in world space, float64.

        Args:
            time: a time code.
            transforms: of that time.

        Raises:
            UnusableStageError: points are missing, their number or the faces change, or the skin cannot be evaluated.
        """
        points = self._points_at(time)
        if points is None or not len(points):
            if self.ragged:
                return np.zeros((0, 3))
            raise UnusableStageError(f"no points of {self.path} at time code {time:g}: export it again")
        if len(points) != self.vertex_count and not self.ragged:
            raise UnusableAsClipError(
                f"{len(points)} points at time code {time:g} and {self.vertex_count} at first: {ONE_TOPOLOGY}"
            )
        if not self.ragged and any(attribute.Get(time) != first for attribute, first in self._topology):
            raise UnusableAsClipError(f"other faces at time code {time:g} than at first: {ONE_TOPOLOGY}")
        if self.skin:
            points = self.skin.shaped(points, time)
            points = self.skin.posed(points, time) if self.skin.has_joints else points
        placed = np.array(transforms.GetLocalToWorldTransform(self._placed), np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.array(points, np.float64) @ placed[:3, :3] + placed[3, :3]

    def faces(self, time: float | Usd.TimeCode) -> tuple[np.ndarray, np.ndarray]:
        """Corners of each face `(face,)`, and the vertices at them, counterclockwise from outside; none of a point cloud."""
        sizes, corners = (np.array((attribute.Get(time) if attribute else None) or [], np.int64) for attribute in self._shape)
        mesh = UsdGeom.Mesh(self.prim)
        if mesh and mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded and sizes.sum() == len(corners):
            last = np.cumsum(sizes) - 1
            corners = corners[np.repeat(2 * last - sizes + 1, sizes) - np.arange(len(corners))]
        return sizes, corners

    def changes(self) -> bool:
        """Whether a point may be another one in each time sample: where its faces change, and in point clouds."""
        return bool(self._topology) or not self.prim.IsA(UsdGeom.Mesh)

    def points_are_ignored(self) -> bool:
        """Whether the points have time samples that the skin ignores."""
        return self._rest is not None and self._points.GetNumTimeSamples() > 1

    def moves(self) -> bool:
        """Whether the points differ between time samples."""
        if len(self.times) < 2:
            return False
        chosen = np.unique(np.linspace(0, len(self.times) - 1, LOOKS).astype(int))
        transforms = UsdGeom.XformCache()
        first = None
        for time in self.times[chosen].tolist():
            transforms.SetTime(time)
            points = self.world_points(time, transforms)
            first = points if first is None else first
            if not np.array_equal(points, first):
                return True
        return False

    def is_shown(self) -> bool:
        """Whether it is rendered: visible at some time, no guide or proxy, no prototype of a point instancer."""
        image = UsdGeom.Imageable(self.prim)
        if image.ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy) or self._is_scattered():
            return False
        shown = image.ComputeVisibility(self.first_time) != UsdGeom.Tokens.invisible
        return shown or any(_varies(UsdGeom.Imageable(one).GetVisibilityAttr()) for one in _upwards(self.prim))

    def hidden_times(self, times: np.ndarray) -> np.ndarray:
        """The times among `times` at which the mesh is invisible."""
        if not any(_varies(UsdGeom.Imageable(one).GetVisibilityAttr()) for one in _upwards(self.prim)):
            return times[:0]
        image = UsdGeom.Imageable(self.prim)
        return np.array([time for time in times.tolist() if image.ComputeVisibility(time) == UsdGeom.Tokens.invisible])

    def _points_at(self, time: float | Usd.TimeCode) -> Vt.Vec3fArray | None:
        return self._points.Get(time) if self._rest is None else self._rest

    def _is_scattered(self) -> bool:
        return any(one.IsA(UsdGeom.PointInstancer) for one in _upwards(self.prim))

    def _sample_times(self) -> np.ndarray:
        """Time samples of points, skin and all transforms above; attributes with one sample are constant."""
        points = [self._points] if self._rest is None else []
        points += self._shape if self.ragged else ()
        return sample_times((*points, *(self.skin.attributes() if self.skin else ()), *transform_attributes(self._placed)))


def sample_times(attributes: Iterable[Usd.Attribute]) -> np.ndarray:
    """Distinct time samples of attributes, ascending; attributes with one sample are constant."""
    found: set[float] = set()
    for attribute in filter(None, attributes):
        times = attribute.GetTimeSamples()
        if attribute.HasSpline():
            times = [knot.GetTime() for knot in attribute.GetSpline().GetKnots().values()]
        if len(times) > 1:
            found.update(times)
        if len(found) > MOST_FRAMES:
            raise UnusableStageError(f"{len(found)} time samples: damaged; export it again")
    return np.array(sorted(found), np.float64)


def _upwards(prim: Usd.Prim) -> list[Usd.Prim]:
    """A prim and its ancestors."""
    found = []
    while prim and not prim.IsPseudoRoot():
        found.append(prim)
        prim = prim.GetParent()
    return found


def transform_attributes(prim: Usd.Prim) -> list[Usd.Attribute]:
    """Transform operations of a prim and its ancestors, up to a reset of the stack."""
    found = []
    for one in _upwards(prim):
        placed = UsdGeom.Xformable(one)
        if placed:
            found += [operation.GetAttr() for operation in placed.GetOrderedXformOps()]
            if placed.GetResetXformStack():
                break
    return found


def _varies(attribute: Usd.Attribute) -> bool:
    return bool(attribute) and attribute.GetNumTimeSamples() > 1
