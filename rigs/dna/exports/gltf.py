"""Drafts of DNA files from glTF avatars."""

import numpy as np
from scipy import sparse

from riginv.errors import InputError
from riginv.geometry.skinning import NUMBERS
from rigs.dna.draft import Draft, MeshDraft
from rigs.dna.exports.blendshapes import Drive, Factor, Shape, blendshape_draft, triangles
from rigs.dna.exports.joints import JointDrive, add_joints
from rigs.gltf import GltfRig
from rigs.gltf.joint_controls import ANGLES
from rigs.gltf.motion import AXES

SEQUENCE = "zyx"  # R = Rx Ry Rz
SAME_MM = 1e-2
STATIC = "static"  # joint for vertices without other joints


def draft_of_gltf(rig: GltfRig) -> Draft:
    """A draft of an avatar: its morph targets, and its joints where they are controls.

    Raises:
        InputError: the format cannot represent the rig; the message has the reason.
    """
    _check_controls(rig)
    count = len(rig.targets)
    resting = [control.name for control in rig.controls[:count] if control.neutral]
    if resting:
        raise InputError(
            f"rig '{rig.name}': target '{resting[0]}' rests at another weight than 0, where a DNA file's controls rest at 0: "
            f"use rig.default_weights=false"
        )
    basis = rig.basis.double().numpy(force=True)
    rest = rig.rest_vertices.double().numpy(force=True)
    faces, motion = triangles(rig.faces.numpy(force=True)), rig.joint_motion
    rows = 1 if motion is None else AXES
    deltas = basis[: rows * count].reshape(count, rows, *rest.shape).sum(axis=1)
    shapes = [Shape(name, [Factor(name, name)], delta) for name, delta in zip(rig.targets, deltas)]
    draft = blendshape_draft(rig.name, rest, faces, {name: Drive(name) for name in rig.targets}, shapes)
    if motion is None:
        return draft
    draft.sequence = SEQUENCE
    frames = motion.rest.double().numpy(force=True)
    points = basis[rows * count :][: NUMBERS * len(frames)].reshape(len(frames), 3, 4, *rest.shape)
    weights = points[:, 0, 3, :, 0].T  # (vertex, frame)
    _check_binding(rig, points, weights, frames, rest)
    names = [name.rpartition(".")[0] for name in rig.control_names[count :: len(ANGLES)]]
    drives = [
        JointDrive(f"{name}.{angle}", number, 3 + axis, 1.0)
        for number, name in enumerate(names)
        for axis, angle in enumerate(ANGLES)
    ]
    world = np.concatenate([frames, np.eye(3, 4)[None]])  # the static joint last
    add_joints(draft, rig.controls[count:], drives, [*names, STATIC], [*motion.parents, -1], world)
    mesh = draft.meshes[0]
    remaining = np.clip(1 - weights.sum(axis=1, keepdims=True), 0, None)
    remaining[remaining < 1e-6] = 0
    all_weights = sparse.csr_array(np.concatenate([np.clip(weights, 0, None), remaining], axis=1))
    draft.meshes = [MeshDraft(mesh.name, mesh.vertices, mesh.faces, all_weights, mesh.deltas)]
    return draft


def _check_controls(rig: GltfRig) -> None:
    """Raises InputError where joints have other controls than three angles in the order of the file."""
    motion = rig.joint_motion
    if motion is not None and (len(motion.moved) or len(motion.scaled)):
        raise InputError(
            f"rig '{rig.name}': some of its joints are translated or scaled by controls, expected angles alone: use "
            f"rig.joint_translation=false rig.joint_scale=false"
        )
    other = next((f"'{name}' rotates in the order {order}" for name, order in rig.joint_orders.items() if order != "XYZ"), "")
    if other:
        raise InputError(f"rig '{rig.name}': joint {other}, expected XYZ: set rig.joint_limit_deg to a number, such as 60")


def _check_binding(rig: GltfRig, points: np.ndarray, weights: np.ndarray, frames: np.ndarray, rest: np.ndarray) -> None:
    """Raises InputError where the bind pose is not the rest pose, or joints have scaled parents."""
    linear = frames[..., :3]
    if np.abs(linear @ linear.transpose(0, 2, 1) - np.eye(3)).max() > 1e-4:
        raise InputError(
            f"rig '{rig.name}': its joints are in a scaled space, which a DNA file does not have: apply the scales of its "
            f"nodes and export it again"
        )
    for number, frame in enumerate(frames):
        expected = weights[:, number, None] * (rest - frame[:, 3])
        found = points[number, 0, :3, :, 0].T
        if np.abs(found - expected).max() > SAME_MM:
            raise InputError(
                f"rig '{rig.name}': its skin was bound in another pose than the one that it rests in, where a DNA file has one "
                f"pose for both: export it in its bind pose"
            )
