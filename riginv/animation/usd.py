"""USD: the rig's mesh under a SkelRoot, with a SkelAnimation of its blendshapes or joints, in centimetres."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import torch

from riginv.animation.animation import Animation
from riginv.animation.glb import quaternions
from riginv.animation.shapes import check_drawable, moved_vertices, moving_shapes
from riginv.animation.skeletons import local_poses
from riginv.errors import InputError
from riginv.geometry.kinematics import Skeleton
from riginv.rig.interface import RigBackend
from riginv.runs.files import atomic_write, discard

FILE = "animation.usdc"
CM = 0.1  # per mm
MOTION = "motion"  # name of the joint of a mesh without joints
CONTROL_NAMES, CONTROL_VALUES = "riginv:controlNames", "riginv:controlValues"


def check(rig: RigBackend) -> None:
    """Raise InputError for a rig with neither blendshapes nor joints, or if usd-core is missing."""
    check_drawable(rig, "usd")
    if importlib.util.find_spec("pxr") is None:
        raise InputError("formats: usd needs the package usd-core: pip install 'riginv[usd]', or leave usd out")


@torch.no_grad()
def write(path: Path, animation: Animation) -> None:
    """Write the mesh and its animation; time codes are frame numbers.

    The SkelAnimation also has the controls, as `riginv:controlNames` and `riginv:controlValues`.
    """
    from pxr import Tf, Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.CreateInMemory()
    numbers = animation.frame_numbers.tolist()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(animation.fps)
    stage.SetFramesPerSecond(animation.fps)
    stage.SetStartTimeCode(numbers[0])
    stage.SetEndTimeCode(numbers[-1])
    top = f"/{Tf.MakeValidIdentifier(animation.rig.name)}"
    stage.SetDefaultPrim(UsdSkel.Root.Define(stage, top).GetPrim())
    mesh = _mesh(stage, f"{top}/mesh", animation.rig)
    skeleton = UsdSkel.Skeleton.Define(stage, f"{top}/skeleton")
    moves = UsdSkel.Animation.Define(stage, f"{top}/animation")
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([moves.GetPath()])
    UsdSkel.BindingAPI.Apply(mesh.GetPrim()).CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    joints = animation.rig.skeleton()
    if joints is None:
        _add_shapes(stage, mesh, moves, animation)
    _add_joints(skeleton, mesh, moves, animation, joints or _one_joint(animation.rig))
    _add_controls(moves, animation)
    with atomic_write(path) as beside:
        named = beside.with_name(f"{beside.name}.usdc")  # USD chooses the format by the suffix
        try:
            stage.GetRootLayer().Export(str(named))
            named.replace(beside)
        finally:
            discard(named)


def _mesh(stage: Any, path: str, rig: RigBackend) -> Any:
    from pxr import UsdGeom, Vt

    mesh = UsdGeom.Mesh.Define(stage, path)
    points = Vt.Vec3fArray.FromNumpy(_cm(rig.rest_vertices))
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    faces = rig.faces.cpu().numpy().astype(np.int32)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    return mesh


def _add_shapes(stage: Any, mesh: Any, moves: Any, animation: Animation) -> None:
    from pxr import Tf, UsdSkel, Vt

    shapes = moving_shapes(animation)
    targets = []
    for number, (name, deltas) in enumerate(zip(shapes.names, shapes.deltas)):
        path = mesh.GetPath().AppendChild(f"shape_{number}_{Tf.MakeValidIdentifier(name)}")
        shape, rows = UsdSkel.BlendShape.Define(stage, path), moved_vertices(deltas)
        shape.CreateOffsetsAttr(Vt.Vec3fArray.FromNumpy(_cm(deltas[rows])))
        shape.CreatePointIndicesAttr(Vt.IntArray.FromNumpy(rows.cpu().numpy().astype(np.int32)))
        targets.append(path)
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    binding.CreateBlendShapesAttr(shapes.names)
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    moves.CreateBlendShapesAttr(shapes.names)
    weights = moves.CreateBlendShapeWeightsAttr()
    for number, row in zip(animation.frame_numbers.tolist(), shapes.weights.cpu().float().numpy()):
        weights.Set(Vt.FloatArray.FromNumpy(row), number)


def _one_joint(rig: RigBackend) -> Skeleton:
    """A skeleton of one joint, for the rigid motion of a rig without joints."""
    origin = torch.zeros(1, 3)
    identity = torch.eye(3, 4, dtype=torch.float64)
    weights = torch.ones(len(rig.rest_vertices), 1)
    return Skeleton((MOTION,), (-1,), origin, origin, weights, lambda controls: identity.expand(len(controls), 1, 3, 4))


def _add_joints(skeleton: Any, mesh: Any, moves: Any, animation: Animation, joints: Skeleton) -> None:
    from pxr import Gf, Tf, UsdSkel, Vt

    paths: list[str] = []
    for name, parent in zip(joints.joint_names, joints.parents):
        legal = Tf.MakeValidIdentifier(name)
        paths.append(f"{paths[parent]}/{legal}" if parent >= 0 else legal)
    heads = _cm(joints.heads).astype(np.float64)
    offsets = [heads[joint] - (heads[parent] if parent >= 0 else 0) for joint, parent in enumerate(joints.parents)]
    for values, create in ((heads, skeleton.CreateBindTransformsAttr), (offsets, skeleton.CreateRestTransformsAttr)):
        create(Vt.Matrix4dArray([Gf.Matrix4d().SetTranslate(Gf.Vec3d(*map(float, value))) for value in values]))
    skeleton.CreateJointsAttr(paths)
    moves.CreateJointsAttr(paths)
    weights = joints.weights.cpu().numpy()
    count = int((weights > 0).sum(axis=1).max())
    order = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    fractions = np.take_along_axis(weights, order, axis=1).astype(np.float32)
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    binding.CreateJointIndicesPrimvar(False, count).Set(Vt.IntArray.FromNumpy(order.astype(np.int32).ravel()))
    binding.CreateJointWeightsPrimvar(False, count).Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(fractions).ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))

    poses = local_poses(joints, animation)
    positions = np.ascontiguousarray(poses.translations * CM, np.float32)
    rotation_values = np.ascontiguousarray(quaternions(poses.rotations), np.float32)  # x y z w, as in Gf
    translations, rotations = moves.CreateTranslationsAttr(), moves.CreateRotationsAttr()
    moves.CreateScalesAttr(Vt.Vec3hArray(len(paths), Gf.Vec3h(1, 1, 1)))
    for number, position, rotation in zip(animation.frame_numbers.tolist(), positions, rotation_values):
        translations.Set(Vt.Vec3fArray.FromNumpy(position), number)
        rotations.Set(Vt.QuatfArray.FromNumpy(rotation), number)


def _add_controls(moves: Any, animation: Animation) -> None:
    from pxr import Sdf, Vt

    names = moves.GetPrim().CreateAttribute(CONTROL_NAMES, Sdf.ValueTypeNames.TokenArray, custom=True)
    names.Set(list(animation.rig.control_names))
    values = moves.GetPrim().CreateAttribute(CONTROL_VALUES, Sdf.ValueTypeNames.FloatArray, custom=True)
    for number, row in zip(animation.frame_numbers.tolist(), animation.controls.cpu().float().numpy()):
        values.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(row)), number)


def _cm(values: torch.Tensor) -> np.ndarray:
    return np.ascontiguousarray(values.detach().cpu().double().numpy() * CM, np.float32)
