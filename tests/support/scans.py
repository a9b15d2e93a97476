"""Scans of small rigs: their own surface with other vertices; as files of many formats."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from riginv.rig.interface import LinearRig
from riginv.tracking.surfaces.triangles import TriangleMesh
from tests.support.blends import blender

MAKE = """
import os, sys, bpy, numpy as np
data = np.load(sys.argv[-1])
folder = os.path.dirname(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 25, 1, 3
points = data["points"]
mesh = bpy.data.meshes.new("head")
mesh.from_pydata((points[:, [0, 2, 1]] * [1, -1, 1]).tolist(), [], data["faces"].tolist())
head = bpy.data.objects.new("head", mesh)
scene.collection.objects.link(head)
less = head.modifiers.new("less", "DECIMATE")
for frame, ratio in enumerate((1.0, 0.8, 0.6), start=1):
    less.ratio = ratio
    less.keyframe_insert("ratio", frame=frame)
bpy.ops.wm.alembic_export(filepath=folder + "/ragged.abc", start=1, end=3, as_background_job=False)
found = {}
for frame in (1, 2, 3):
    scene.frame_set(frame)
    shown = head.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    found[f"points{frame}"] = np.array([vertex.co[:] for vertex in shown.vertices])
    found[f"faces{frame}"] = np.array([face.vertices[:] for face in shown.polygons])
np.savez(folder + "/expected.npz", **found)
os._exit(0)
"""


@torch.no_grad()
def posed_mesh(rig: LinearRig, controls: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a pose."""
    return rig(controls[None])[0].double().numpy(), rig.faces.numpy()


def resampled(rig: LinearRig, controls: Tensor, seed: int = 0) -> TriangleMesh:
    """The surface of a pose, exactly, with random points of its triangles as further vertices, in another order."""
    points, faces = posed_mesh(rig, controls)
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(3) * 3, len(faces))
    centres = (weights[..., None] * points[faces]).sum(axis=1)
    number = len(points) + np.arange(len(faces))
    split = np.concatenate([np.stack([faces[:, a], faces[:, b], number], axis=1) for a, b in ((0, 1), (1, 2), (2, 0))])
    order = rng.permutation(len(points) + len(faces))
    inverse = np.argsort(order)
    return TriangleMesh(np.concatenate([points, centres])[order], inverse[split])


def write_ply(path, points: np.ndarray, faces: np.ndarray | None) -> None:
    """A scan as a file."""
    mesh = trimesh.PointCloud(points) if faces is None else trimesh.Trimesh(points, faces, process=False)
    mesh.export(path)


def write_ragged(path, scans: list[tuple[np.ndarray, np.ndarray | None]], **more) -> None:
    """Scans as ragged arrays."""
    arrays = {
        "points": np.concatenate([points for points, _ in scans]).astype(np.float32),
        "offsets": np.cumsum([0, *(len(points) for points, _ in scans)]),
    }
    if scans[0][1] is not None:
        arrays["faces"] = np.concatenate([faces for _, faces in scans])
        arrays["face_offsets"] = np.cumsum([0, *(len(faces) for _, faces in scans)])
    np.savez(path, **(arrays | more))


def new_stage(path: Path, **metadata):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, metadata.get("metres", 0.001))
    UsdGeom.SetStageUpAxis(stage, metadata.get("up", "Y"))
    stage.SetTimeCodesPerSecond(30)
    return stage


def usd_mesh(stage, points, faces, time=None, path="/scan/head") -> None:
    """The mesh of a stage at a time."""
    from pxr import Usd, UsdGeom, Vt

    mesh, at = UsdGeom.Mesh.Define(stage, path), Usd.TimeCode.Default() if time is None else time
    mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(np.asarray(points, np.float32)), at)
    mesh.CreateFaceVertexCountsAttr().Set([3] * len(faces), at)
    mesh.CreateFaceVertexIndicesAttr().Set(faces.ravel().tolist(), at)


def write_alembic(folder: Path, points: np.ndarray, faces: np.ndarray) -> Path:
    """An archive ragged.abc of a mesh that is decimated more and more in frames 1 to 3, and these as expected.npz, z up."""
    np.savez(folder / "mesh.npz", points=points, faces=faces)
    (folder / "make.py").write_text(MAKE)
    command = [blender(), str(folder / "make.py"), str(folder / "mesh.npz")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder / "ragged.abc"
