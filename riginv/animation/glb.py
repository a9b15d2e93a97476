"""Animated GLB: the rig's mesh with its blendshapes as morph targets, or its joints as a skin, in metres."""

from pathlib import Path

import numpy as np
import scipy
import torch

from riginv.animation.animation import Animation
from riginv.animation.glb_document import GlbDocument
from riginv.animation.shapes import check_drawable, moved_vertices, moving_shapes
from riginv.animation.skeletons import local_poses
from riginv.geometry.kinematics import Skeleton
from riginv.rig.interface import RigBackend

FILE = "animation.glb"
METRES = 0.001  # per mm
PER_SET = 4  # joints of a vertex in one attribute


def check(rig: RigBackend) -> None:
    """Raise InputError for a rig with neither blendshapes nor joints."""
    check_drawable(rig, "glb")


@torch.no_grad()
def write(path: Path, animation: Animation) -> None:
    """Write the mesh and its animation; `extras.targetNames` holds the names of shapes, as importers expect."""
    document = GlbDocument(animation.source or animation.rig.name)
    times = document.times(animation.seconds.numpy())
    skeleton = animation.rig.skeleton()
    if skeleton is None:
        _add_shapes(document, animation, times)
    else:
        _add_joints(document, animation, skeleton, times)
    document.save(path)


def _add_shapes(document: GlbDocument, animation: Animation, times: int) -> None:
    shapes = moving_shapes(animation)
    primitive = _primitive(document, animation.rig)
    primitive["targets"] = []
    for deltas in shapes.deltas:
        rows = moved_vertices(deltas)
        target = document.sparse(len(deltas), rows.cpu().numpy(), (deltas[rows] * METRES).cpu().numpy())
        primitive["targets"].append({"POSITION": target})
    extras = {"targetNames": shapes.names}
    mesh = {"name": animation.rig.name, "primitives": [primitive], "weights": [0.0] * len(shapes.names), "extras": extras}
    node = document.node({"name": animation.rig.name, "mesh": document.add("meshes", mesh)}, in_scene=True)
    document.channel(node, "weights", times, shapes.weights.cpu().numpy().reshape(-1, 1))
    if animation.motion is not None:
        motion = animation.motion.cpu().double().numpy()
        document.channel(node, "translation", times, motion[:, :3, 3] * METRES)
        document.channel(node, "rotation", times, quaternions(motion[:, None, :3, :3])[:, 0])


def _add_joints(document: GlbDocument, animation: Animation, skeleton: Skeleton, times: int) -> None:
    heads, parents = skeleton.heads.cpu().double().numpy() * METRES, skeleton.parents
    joints = [
        document.node(
            {"name": name, "translation": (heads[joint] - (heads[parents[joint]] if parents[joint] >= 0 else 0)).tolist()},
            in_scene=parents[joint] < 0,
        )
        for joint, name in enumerate(skeleton.joint_names)
    ]
    for joint, parent in enumerate(parents):
        if parent >= 0:
            document.content["nodes"][joints[parent]].setdefault("children", []).append(joints[joint])
    primitive = _primitive(document, animation.rig)
    primitive["attributes"] |= _influences(document, skeleton)
    binds = np.broadcast_to(np.eye(4, dtype=np.float32), (len(joints), 4, 4)).copy()
    binds[:, 3, :3] = -heads  # column by column
    skin = {"joints": joints, "skeleton": joints[0], "inverseBindMatrices": document.array(binds.reshape(-1, 16), "MAT4")}
    mesh = document.add("meshes", {"name": animation.rig.name, "primitives": [primitive]})
    document.node({"name": animation.rig.name, "mesh": mesh, "skin": document.add("skins", skin)}, in_scene=True)
    poses = local_poses(skeleton, animation)
    rotations = quaternions(poses.rotations)
    for joint, node in enumerate(joints):
        document.channel(node, "rotation", times, rotations[:, joint])
        if parents[joint] < 0 or np.ptp(poses.translations[:, joint], axis=0).max() > 1e-3:
            document.channel(node, "translation", times, poses.translations[:, joint] * METRES)


def _primitive(document: GlbDocument, rig: RigBackend) -> dict:
    import trimesh  # half a second, and only for formats=[glb]

    vertices, faces = rig.rest_vertices.cpu().double().numpy(), rig.faces.cpu().numpy()
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0.5, normals, [0.0, 0.0, 1.0])  # of a vertex without faces
    attributes = {
        "POSITION": document.array((vertices * METRES).astype(np.float32), "VEC3", bounds=True, vertices=True),
        "NORMAL": document.array(normals.astype(np.float32), "VEC3", vertices=True),
    }
    return {"attributes": attributes, "indices": document.indices(faces.ravel()), "mode": 4}


def _influences(document: GlbDocument, skeleton: Skeleton) -> dict[str, int]:
    """Joint indices and weights of each vertex, largest first, four per attribute."""
    weights = skeleton.weights.cpu().double().numpy()
    count = int((weights > 0).sum(axis=1).max())
    order = np.argsort(-weights, axis=1, kind="stable")[:, : PER_SET * -(-count // PER_SET)]
    fractions = np.take_along_axis(weights, order, axis=1)
    fractions /= fractions.sum(axis=1, keepdims=True)
    order = np.where(fractions > 0, order, 0).astype(np.uint16)
    attributes = {}
    for number in range(order.shape[1] // PER_SET):
        part = slice(PER_SET * number, PER_SET * (number + 1))
        attributes[f"JOINTS_{number}"] = document.array(order[:, part], "VEC4", vertices=True)
        attributes[f"WEIGHTS_{number}"] = document.array(fractions[:, part].astype(np.float32), "VEC4", vertices=True)
    return attributes


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """Unit quaternions x y z w `(frame, joint, 4)` of rotations `(frame, joint, 3, 3)`, with signs continuous over frames."""
    found = scipy.spatial.transform.Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat().reshape(*rotations.shape[:2], 4)
    flipped = (found[1:] * found[:-1]).sum(axis=-1) < 0
    signs = np.cumprod(np.where(flipped, -1.0, 1.0), axis=0)
    found[1:] *= signs[..., None]
    return found
