"""Clips of a toy rig in every format, written apart from the readers under test."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
import yaml

from riginv.clips.clip import Clip
from riginv.clips.open import open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence
from riginv.clips.units import resolve_units
from riginv.rig.interface import RigBackend
from tests.support.avatars import AvatarWriter

READERS = yaml.safe_load((Path(__file__).parents[2] / "conf/reading/default.yaml").read_text())["readers"]


def reading_options(**options: Any) -> ReadingOptions:
    """Reading options with the readers that the config names."""
    return ReadingOptions(**options, readers=READERS)


def performance(rig: RigBackend, frames: int = 12) -> np.ndarray:
    """Meshes `(frame, vertex, 3)`, mm, of smooth poses of a rig."""
    time = torch.linspace(0, 1, frames)[:, None]
    phase = torch.arange(len(rig.controls))[None] * 0.7
    share = 0.4 + 0.35 * torch.sin(5 * time + phase)
    controls = rig.neutral_controls + share * (rig.upper - rig.neutral_controls)
    with torch.no_grad():
        return rig(controls).numpy().astype(np.float64)


def write_obj(path: Path, points: np.ndarray, faces: np.ndarray, decimals: int = 6) -> Path:
    lines = ["# a comment", "o head"]
    lines += [f"v {x:.{decimals}f} {y:.{decimals}f} {z:.{decimals}f}" for x, y, z in points]
    lines += ["vn 0 0 1", "s 1"] + ["f " + " ".join(f"{corner + 1}//1" for corner in face) for face in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def obj_sequence(folder: Path, meshes: np.ndarray, faces: np.ndarray, first: int = 1001) -> str:
    folder.mkdir(exist_ok=True)
    for number, points in enumerate(meshes):
        write_obj(folder / f"shot.{first + number:04d}.obj", points, faces)
    return str(folder / "shot.%04d.obj")


def ply_sequence(folder: Path, meshes: np.ndarray, faces: np.ndarray, encoding: str = "binary") -> str:
    folder.mkdir(exist_ok=True)
    for number, points in enumerate(meshes):
        mesh = trimesh.Trimesh(points, faces, process=False)
        (folder / f"shot_{number}.ply").write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding=encoding))
    return str(folder / "shot_*.ply")


def write_npz(path: Path, meshes: np.ndarray, faces: np.ndarray, fps: float = 24.0, compressed: bool = False) -> Path:
    save = np.savez_compressed if compressed else np.savez
    save(path, vertices=meshes.astype(np.float32), faces=faces, fps=fps)
    return path


def write_mdd(path: Path, meshes: np.ndarray, fps: float = 25.0) -> Path:
    frames, vertices = meshes.shape[:2]
    times = struct.pack(f">{frames}f", *(number / fps for number in range(frames)))
    path.write_bytes(struct.pack(">2i", frames, vertices) + times + meshes.astype(">f4").tobytes())
    return path


def write_pc2(path: Path, meshes: np.ndarray, start: float = 1.0) -> Path:
    frames, vertices = meshes.shape[:2]
    header = b"POINTCACHE2\0" + struct.pack("<iiffi", 1, vertices, start, 1.0, frames)
    path.write_bytes(header + meshes.astype("<f4").tobytes())
    return path


def write_usd(path: Path, meshes: np.ndarray, faces: np.ndarray, fps: float = 24.0) -> Path:
    """In centimetres, z up, within a prim that is moved by 10 cm."""
    from pxr import Gf, Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(str(path))
    stage.SetTimeCodesPerSecond(fps)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.Xform.Define(stage, "/world").AddTranslateOp().Set(Gf.Vec3d(10, 0, 0))
    mesh = UsdGeom.Mesh.Define(stage, "/world/head")
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.reshape(-1).tolist())
    points = mesh.CreatePointsAttr()
    for number, vertices in enumerate(meshes):
        z_up = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1) / 10 - [10, 0, 0]
        points.Set(Vt.Vec3fArray.FromNumpy(z_up.astype(np.float32)), float(number + 1))
    stage.GetRootLayer().Save()
    return path


def write_skinned_usd(path: Path, rig: RigBackend, frames: int = 7) -> Path:
    """Blend shapes of a rig below a skeleton, as our own writer makes them."""
    from pxr import Usd

    from riginv.animation.usd import write
    from tests.support.animations import moving

    written = path.with_name("written.usdc")
    write(written, moving(rig, numbers=torch.arange(frames)))
    Usd.Stage.Open(str(written)).Export(str(path))
    return path


def write_animated_glb(path: Path, meshes: np.ndarray, faces: np.ndarray, fps: float = 30.0) -> Path:
    """One morph target for each frame, fully on at its own: any meshes can be written so. The node turns as it goes."""
    avatar = AvatarWriter()
    rest = meshes[0] / 1000
    targets = [avatar.accessor(mesh / 1000 - rest) for mesh in meshes]
    primitive = avatar.primitive(avatar.accessor(rest), faces, targets)
    node = avatar.node("Head", mesh=avatar.mesh("Head", [primitive], [f"frame_{number}" for number in range(len(meshes))]))
    slides = np.stack([np.zeros(2), np.linspace(0, 1, 2), np.zeros(2)], axis=1)
    times, ends = np.arange(len(meshes)) / fps, [0.0, (len(meshes) - 1) / fps]
    avatar.animation("take", (node, "weights", times, np.eye(len(meshes))), (node, "translation", ends, slides))
    return avatar.write(path)


def opened(path, rig, **options) -> MeshSequence:
    return open_sequence(str(path), rig, reading_options(**options))


def as_clip(sequence, rig, unit="auto", up="auto", fps=None, **frames) -> Clip:
    return Clip(sequence, resolve_units(sequence, rig, reading_options(unit=unit, up=up, fps=fps)), **frames)
