"""Stages with skeletons and blend shapes, written with usd-core, and what its own baking makes of them."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from riginv.clips.options import ReadingOptions
from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.in_blender.worker import RefusedError
from rigs.usd.clip import UsdClip

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

JOINTS = ("root", "root/neck", "root/neck/head")
SHAPES = ("smile", "jaw")


def new_stage(path: Path, rate: float | None = 24.0, up: str = "Y", metres: float = 0.01) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    UsdGeom.SetStageUpAxis(stage, up)
    if rate is not None:
        stage.SetTimeCodesPerSecond(rate)
    return stage


def add_mesh(stage: Usd.Stage, path: str, vertices: int = 30, seed: int = 0) -> UsdGeom.Mesh:
    """A mesh of triangles with random points of about 10 units."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    points = np.random.default_rng(seed).normal(size=(vertices, 3)) * 10
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    faces = np.stack([np.arange(vertices - 2), np.arange(1, vertices - 1), np.arange(2, vertices)], axis=1)
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.ravel().tolist())
    return mesh


def add_skeleton(stage: Usd.Stage, path: str) -> UsdSkel.Skeleton:
    """Three joints, one above the other, whose rest is not where they were bound."""
    skeleton = UsdSkel.Skeleton.Define(stage, path)
    heads = [Gf.Vec3d(0, 0, 0), Gf.Vec3d(0, 5, 0), Gf.Vec3d(0, 9, 1)]
    skeleton.CreateJointsAttr(JOINTS)
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d().SetTranslate(head) for head in heads]))
    offsets = [heads[0], heads[1] - heads[0], heads[2] - heads[1] + Gf.Vec3d(0, 0.5, 0)]
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray([Gf.Matrix4d().SetTranslate(offset) for offset in offsets]))
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    return skeleton


def add_animation(stage: Usd.Stage, path: str, times: Sequence[float], seed: int = 1) -> UsdSkel.Animation:
    """Joints and weights that move at every time."""
    random, moves = np.random.default_rng(seed), UsdSkel.Animation.Define(stage, path)
    moves.CreateJointsAttr(JOINTS)
    moves.CreateBlendShapesAttr(SHAPES)
    translations, rotations, scales = moves.CreateTranslationsAttr(), moves.CreateRotationsAttr(), moves.CreateScalesAttr()
    weights = moves.CreateBlendShapeWeightsAttr()
    for time in times:
        turns = [Gf.Rotation(Gf.Vec3d(*random.normal(size=3)), float(random.uniform(0, 60))).GetQuat() for _ in JOINTS]
        translations.Set(Vt.Vec3fArray.FromNumpy((random.normal(size=(3, 3)) + np.array([0, 4, 0])).astype(np.float32)), time)
        rotations.Set(Vt.QuatfArray([Gf.Quatf(turn) for turn in turns]), time)
        scales.Set(Vt.Vec3hArray([Gf.Vec3h(*random.uniform(0.9, 1.2, 3)) for _ in JOINTS]), time)
        weights.Set(random.uniform(-0.2, 1.2, len(SHAPES)).tolist(), time)
    return moves


def add_shapes(mesh: UsdGeom.Mesh, seed: int = 2, inbetween: float | None = 0.5) -> None:
    """Two blend shapes: one for all vertices with an in-between, one for a few."""
    random, stage, count = np.random.default_rng(seed), mesh.GetPrim().GetStage(), len(mesh.GetPointsAttr().Get(0))
    binding, targets = UsdSkel.BindingAPI.Apply(mesh.GetPrim()), []
    for name, moved in zip(SHAPES, (None, [1, 4, 7])):
        shape = UsdSkel.BlendShape.Define(stage, mesh.GetPath().AppendChild(name))
        size = count if moved is None else len(moved)
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(random.normal(size=(size, 3)).astype(np.float32)))
        if moved is not None:
            shape.CreatePointIndicesAttr(moved)
        if moved is None and inbetween is not None:
            between = shape.CreateInbetween("half")
            between.SetWeight(inbetween)
            between.SetOffsets(Vt.Vec3fArray.FromNumpy(random.normal(size=(size, 3)).astype(np.float32)))
        targets.append(shape.GetPath())
    binding.CreateBlendShapesAttr(SHAPES)
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)


def add_influences(mesh: UsdGeom.Mesh, seed: int = 3, per_vertex: int = 2, rigid: bool = False) -> UsdSkel.BindingAPI:
    random, count = np.random.default_rng(seed), 1 if rigid else len(mesh.GetPointsAttr().Get(0))
    weights = random.dirichlet(np.ones(per_vertex), count).astype(np.float32)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    joints = random.integers(0, len(JOINTS), (count, per_vertex)).astype(np.int32)
    binding.CreateJointIndicesPrimvar(rigid, per_vertex).Set(Vt.IntArray.FromNumpy(joints.ravel()))
    binding.CreateJointWeightsPrimvar(rigid, per_vertex).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetTranslate(Gf.Vec3d(0.5, 0, -1)))
    return binding


def character(stage: Usd.Stage, path: str, times: Sequence[float], meshes: int = 1, seed: int = 0) -> None:
    """A SkelRoot with skinned meshes of blend shapes, bound and animated by the root."""
    root = UsdSkel.Root.Define(stage, path).GetPrim()
    add_skeleton(stage, f"{path}/Skel")
    moves = add_animation(stage, f"{path}/Anim", times, seed)
    for number in range(meshes):
        mesh = add_mesh(stage, f"{path}/Mesh{number}", 30 + number, seed + number)
        add_shapes(mesh, seed + 10 * number)
        add_influences(mesh, seed + 20 * number)
    binding = UsdSkel.BindingAPI.Apply(root)
    binding.CreateSkeletonRel().SetTargets([f"{path}/Skel"])
    binding.CreateAnimationSourceRel().SetTargets([moves.GetPath()])


def baked(path: Path, meshes: Iterable[str], times: Sequence[float]) -> np.ndarray:
    """World points `(frame, vertex, 3)` of meshes by UsdSkel.BakeSkinning, which samples where the animation does."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(Usd.Stage.Open(str(path)).Flatten())
    stage = Usd.Stage.Open(layer)
    for prim in stage.Traverse():
        prim.SetInstanceable(False)
    assert UsdSkel.BakeSkinning(stage.Traverse(), Gf.Interval.GetFullInterval())
    return np.stack([np.concatenate([world(stage, mesh, time) for mesh in meshes]) for time in times])


def world(stage: Usd.Stage, mesh: str, time: float) -> np.ndarray:
    """The points of a mesh of points in the world, `(vertex, 3)`."""
    prim = stage.GetPrimAtPath(mesh)
    placed = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(prim))
    return np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(time), np.float64) @ placed[:3, :3] + placed[3, :3]


class SameProcess:
    """The workers' own scenes in this process, in place of a pool: starting one takes seconds."""

    def __init__(self, command: Sequence[str], load: dict[str, Any], *settings: Any) -> None:
        from rigs.usd.play_bones import UsdBones
        from rigs.usd.play_usd import UsdScene

        self.scene, self.load = UsdBones() if "play_bones" in command[-1] else UsdScene(), load

    def describe(self, attempts: int = 1) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        return self._answer(lambda: (self.scene.load(**self.load), self.scene.describe())[1])

    def evaluate(self, names: Sequence[str], controls: np.ndarray) -> np.ndarray:
        return self._answer(lambda: self.scene.evaluate(names, controls))[1]["vertices"]

    def close(self) -> None:
        self.scene = None

    def _answer(self, ask: Callable[[], Any]) -> Any:
        try:
            return ask()
        except RefusedError as error:
            raise WorkerRefusedError(str(error), error.are_scans, error.meshes) from None


def opened(path: Path, vertices: int | None = None, **options: Any) -> UsdClip:
    """A stage as a clip, read in this process."""
    with mock.patch("rigs.worker_clip.WorkerPool", SameProcess):
        return UsdClip(str(path), ReadingOptions(**options), vertices)
