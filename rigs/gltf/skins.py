"""Skins: the nodes that move the vertices of a primitive, and their weights."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.geometry.kinematics import compose
from riginv.geometry.skinning import SUM_TOLERANCE, check_weights
from rigs.gltf.accessors import MOST_NUMBERS, count_of, quantised_step, read_indices, read_numbers
from rigs.gltf.container import GltfFile
from rigs.gltf.scene import Scene

NOTHING = 1e-6  # greatest sum of skin weights of a vertex that counts as unskinned


class Binding(NamedTuple):
    """Binding of vertices to nodes.

    Attributes:
        nodes: indices of the nodes, `(joint,)`.
        weights: skin weights `(vertex, joint)`; each row sums to 1.
        inverse_binds: `(joint, 3, 4)`: from the primitive's local coordinates to those of each node, metres.
    """

    nodes: np.ndarray
    weights: np.ndarray
    inverse_binds: np.ndarray

    def posed(self, world: Tensor) -> "PosedBinding":
        """The binding for world transforms `(node, 3, 4)`."""
        transforms = compose(world[torch.from_numpy(self.nodes)], torch.from_numpy(self.inverse_binds))
        return PosedBinding(self.nodes, self.weights, transforms.numpy())


class PosedBinding(NamedTuple):
    """A binding in one pose.

    Attributes:
        nodes: indices of the nodes, `(joint,)`.
        weights: skin weights `(vertex, joint)`; each row sums to 1.
        transforms: `(joint, 3, 4)`: from the primitive's local coordinates to world space, metres.
    """

    nodes: np.ndarray
    weights: np.ndarray
    transforms: np.ndarray


def binding(file: GltfFile, scene: Scene, node: int, attributes: dict[str, int], vertices: int, user: str) -> Binding:
    """The binding of a primitive. With a skin, the transform of the node is ignored, as glTF specifies.

    Raises:
        InputError: negative weights, or missing joints or matrices; the message names the skin.
    """
    skin_number = file.document["nodes"][node].get("skin")
    if skin_number is None:
        return Binding(np.array([node]), np.ones((vertices, 1)), np.eye(4)[None, :3])
    skin = file.item("skins", skin_number, f"node '{scene.names[node]}'")
    label = f"skin '{skin['name']}'" if skin.get("name") else f"skins[{skin_number}]"
    joints = skin["joints"]
    if not joints:
        raise InputError(f"{file.path}: {label} has no joints: export it again")
    for joint in joints:
        file.item("nodes", joint, label)
    if vertices * len(joints) > MOST_NUMBERS:
        raise InputError(f"{file.path}: {label} has {len(joints)} joints for {vertices} vertices: too many to be meant")
    names = [scene.names[joint] for joint in joints]
    weights = _weights(file, attributes, vertices, names, f"{user}, {label}")
    return Binding(np.array(joints), weights, _inverse_binds(file, skin, len(joints), label))


def _inverse_binds(file: GltfFile, skin: dict, joints: int, label: str) -> np.ndarray:
    """Inverse bind matrices `(joint, 3, 4)`; identities where the skin has none."""
    if "inverseBindMatrices" not in skin:
        return np.tile(np.eye(4)[:3], (joints, 1, 1))
    accessor, user = skin["inverseBindMatrices"], f"inverseBindMatrices of {label}"
    count = count_of(file, accessor, user)
    if count < joints:
        raise InputError(
            f"{file.path}: accessors[{accessor}], {user}, holds {count} matrices for {joints} joints: export it again"
        )
    matrices = read_numbers(file, accessor, "MAT4", user)[:joints].reshape(joints, 4, 4).transpose(0, 2, 1)
    affine = np.abs(matrices[:, 3] - [0, 0, 0, 1]).max(axis=1) < 1e-4
    if not affine.all():
        raise InputError(
            f"{file.path}: {user}: matrix {int(np.argmin(affine))} does not end in the row 0 0 0 1: export it again"
        )
    return np.ascontiguousarray(matrices[:, :3])


def _weights(file: GltfFile, attributes: dict[str, int], vertices: int, names: list[str], user: str) -> np.ndarray:
    """Skin weights `(vertex, joint)` from all sets of JOINTS and WEIGHTS, normalised."""
    total, first = np.zeros((vertices, len(names))), np.zeros(vertices, np.int64)
    tolerance, number = SUM_TOLERANCE, 0
    while number == 0 or f"JOINTS_{number}" in attributes or f"WEIGHTS_{number}" in attributes:
        for field in (f"JOINTS_{number}", f"WEIGHTS_{number}"):
            if field not in attributes:
                raise InputError(
                    f"{file.path}: {user}: the mesh has a skin, but no {field}: bind it to the skin, or leave the mesh out "
                    f"with rig.exclude=[NAME]"
                )
            count = count_of(file, attributes[field], f"{field} of {user}")
            if count != vertices:
                raise InputError(
                    f"{file.path}: {field} of {user} has {count} elements for {vertices} vertices: export it again"
                )
        joints = read_indices(file, attributes[f"JOINTS_{number}"], "VEC4", f"JOINTS_{number} of {user}")
        weights = read_numbers(file, attributes[f"WEIGHTS_{number}"], "VEC4", f"WEIGHTS_{number} of {user}")
        tolerance = max(tolerance, 4 * quantised_step(file, attributes[f"WEIGHTS_{number}"]))
        wrong = (weights != 0) & (joints >= len(names))
        if wrong.any():
            vertex, slot = np.argwhere(wrong)[0]
            raise InputError(
                f"{file.path}: JOINTS_{number} of {user}: vertex {vertex} follows joint {joints[vertex, slot]}, the skin has "
                f"joints 0 to {len(names) - 1}: bind it again, or export it again"
            )
        if number == 0:
            first = np.where(joints[:, 0] < len(names), joints[:, 0], 0)
        np.add.at(total, (np.arange(vertices)[:, None], np.where(weights != 0, joints, 0)), weights)
        number += 1
    total = _normalised(file, total, first, tolerance, names, user)
    check_weights(torch.tensor(total), f"{file.path}: {user}", names)
    return total


def _normalised(
    file: GltfFile, weights: np.ndarray, first: np.ndarray, tolerance: float, names: list[str], user: str
) -> np.ndarray:
    """Skin weights normalised as engines do; a vertex without any follows its `first` joint."""
    sums = weights.sum(axis=1)
    if (weights < 0).any() or not np.isfinite(sums).all():
        return weights  # refused by `check_weights`
    none = sums <= NOTHING
    off = ~none & (np.abs(sums - 1) > tolerance)
    if off.any():
        vertex = int(np.argmax(np.abs(np.where(off, sums, 1.0) - 1)))
        file.note(
            f"The skin weights of {int(off.sum())} vertices of {user} do not sum to 1 (those of vertex {vertex} to "
            f"{sums[vertex]:.3g}): they were divided by their sum."
        )
    if none.any():
        vertex = int(np.argmax(none))
        file.note(
            f"{int(none.sum())} vertices of {user} have no skin weights (the first is vertex {vertex}): they follow the first "
            f"joint that the file names for them, '{names[first[vertex]]}' for that one."
        )
    weights = weights / np.where(none, 1.0, sums)[:, None]
    weights[none] = 0.0
    weights[none, first[none]] = 1.0
    return weights
