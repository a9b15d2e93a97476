"""Controlled joints as frames: each moves the vertices bound to it and to the uncontrolled nodes below it."""

from collections.abc import Iterable
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from riginv.errors import InputError, listed
from riginv.geometry.kinematics import compose
from riginv.geometry.skinning import NUMBERS, matrix_basis
from rigs.gltf.accessors import MOST_NUMBERS
from rigs.gltf.avatar import Avatar, blend_transforms, check_distances, transform_vectors

NEGLIGIBLE_MM = 1e-4  # a joint whose fraction of a target's deltas stays below this does not rotate them
_IDLE = "have no vertices, carry one other joint and are never animated"
LINEAR = 9  # entries of the 3x4 matrix of a joint that act on deltas: its last column moves points only


class Frames(NamedTuple):
    """Joints with controls.

    Attributes:
        names: of the joints.
        parents: index of each frame's parent, -1 for a root.
        rest: `(frame, 3, 4)`: the coordinate system that each rotates in, in world space at rest, mm.
        of_node: index of the frame that moves each node of the scene, -1 for none.
        nodes: the node of each frame.
        parent_axes: axes of the node's parent in world space at rest, unit vectors as columns, `(frame, 3, 3)`.
        parent_scales: lengths of these axes, `(frame, 3)`.
    """

    names: list[str]
    parents: list[int]
    rest: Tensor
    of_node: np.ndarray
    nodes: list[int]
    parent_axes: Tensor
    parent_scales: Tensor


class FrameBasis(NamedTuple):
    """Basis of the entries of the frames' matrices.

    Attributes:
        rows: `(12 frame + 9 pair, vertex, 3)` float32, mm.
        pairs: `(pair, 2)` int64: a frame and a target whose deltas it rotates.
    """

    rows: Tensor
    pairs: Tensor


def joint_frames(avatar: Avatar, include: list[str], animated: Iterable[int] = ()) -> Frames:
    """Joints of the avatar's skins that match globs and move any vertex, directly or through nodes below them.

    Args:
        animated: nodes that an animation of the file moves. Those above joints are joints, too. Where there are any, a joint
            without vertices that carries a single other joint and that no animation moves is left out.

    Raises:
        InputError: there are none, or one has a singular transform.
    """
    scene, file = avatar.scene, avatar.file
    skins = {file.document["nodes"][submesh.node].get("skin") for submesh in avatar.submeshes} - {None}
    joints = {joint for skin in skins for joint in file.item("skins", skin, "a node")["joints"]}
    own = _own_vertices(avatar)
    loaded = _loaded(avatar, own)
    named = {j for j in joints if loaded[j] and any(fnmatchcase(scene.names[j], glob) for glob in include)}
    if not named:
        known = ", ".join(scene.names[joint] for joint in sorted(joints) if loaded[joint])[:300] or "none"
        raise InputError(
            f"{file.path}: rig.joint_include={include} names no joint that moves a vertex; its joints are: {known}"
        )
    moving = {node for node in animated if loaded[node]}
    idle = _idle(avatar, named, own, moving) if moving & named else set()
    for numbers, what in ((joints - set(np.flatnonzero(loaded)), "move no vertex"), (idle, _IDLE)):
        if numbers:
            names = [scene.names[node] for node in sorted(numbers)]
            file.note(f"{len(names)} joints {what}, and are no controls: {listed(names)}.")
    if moving & named:
        named |= {node for node in moving if any(fnmatchcase(scene.names[node], glob) for glob in include)}
    return _frames_of(avatar, named - idle)


def _frames_of(avatar: Avatar, named: set[int]) -> Frames:
    """The frames of nodes, parents first."""
    scene = avatar.scene
    of_node = np.full(len(scene.names), -1)
    order: list[int] = []
    parents: list[int] = []
    for level in scene.levels:
        for node in level.tolist():
            above = of_node[scene.parents[node]] if scene.parents[node] >= 0 else -1
            of_node[node] = above
            if node in named:
                of_node[node] = len(order)
                order.append(node)
                parents.append(int(above))
    above = [scene.world[scene.parents[node], :, :3] if scene.parents[node] >= 0 else torch.eye(3).double() for node in order]
    scales = torch.stack(above).norm(dim=1).clamp_min(1e-12)
    axes = torch.stack(above) / scales[:, None]
    return Frames([scene.names[n] for n in order], parents, _rest_transforms(avatar, order), of_node, order, axes, scales)


def _idle(avatar: Avatar, named: set[int], own: np.ndarray, moving: set[int]) -> set[int]:
    """Joints without vertices that no animation moves and below which a single branch moves vertices."""
    branches = np.zeros(len(own), int)
    loaded = _loaded(avatar, own)
    for node, parent in enumerate(avatar.scene.parents):
        if parent >= 0 and loaded[node]:
            branches[parent] += 1
    found = {node for node in named - moving if not own[node] and branches[node] == 1}
    return found if found < named else set()


def _rest_transforms(avatar: Avatar, nodes: list[int]) -> Tensor:
    scene, found = avatar.scene, []
    for node in nodes:
        parent = scene.parents[node]
        rest = scene.rigid[node] if parent < 0 else compose(scene.world[parent], scene.rigid[node])
        if abs(float(torch.linalg.det(rest[:, :3]))) < 1e-12:
            raise InputError(
                f"{avatar.file.path}: joint '{scene.names[node]}' is in a space that is scaled to nothing: leave it out of "
                f"rig.joint_include, or export it with another scale"
            )
        found.append(torch.cat([rest[:, :3], rest[:, 3:] * avatar.mm], dim=1))
    return torch.stack(found)


def _own_vertices(avatar: Avatar) -> np.ndarray:
    """Whether vertices are bound to each node, `(node,)`."""
    own = np.zeros(len(avatar.scene.names), bool)
    for submesh in avatar.submeshes:
        binding = submesh.rest_binding(avatar.file, avatar.scene)
        own[binding.nodes[(binding.weights > 0).any(axis=0)]] = True
    return own


def _loaded(avatar: Avatar, own: np.ndarray) -> np.ndarray:
    """Whether each node moves a vertex, directly or through a node below it, `(node,)`."""
    loaded = own.copy()
    for level in reversed(avatar.scene.levels):
        for node in level.tolist():
            if avatar.scene.parents[node] >= 0:
                loaded[avatar.scene.parents[node]] |= loaded[node]
    return loaded


def frame_basis(avatar: Avatar, frames: Frames) -> FrameBasis:
    """The basis of the frames' matrices, each about its joint's rest position, and of their products with morph weights.

    Raises:
        InputError: it would not fit in memory.
    """
    count, vertices = len(frames.names), len(avatar.rest)
    points, weights = np.zeros((count, vertices, 3), np.float32), np.zeros((count, vertices), np.float32)
    centres = frames.rest[:, :, 3].numpy()
    for submesh in avatar.submeshes:
        binding, here = submesh.rest_binding(avatar.file, avatar.scene), avatar.vertex_map[submesh.vertices]
        positions, frame_of = submesh.positions(avatar.file), frames.of_node[binding.nodes]
        for frame in np.unique(frame_of[frame_of >= 0]):
            some = np.flatnonzero(frame_of == frame)
            blend, weight = blend_transforms(binding, some, avatar.mm), binding.weights[:, some].sum(axis=1)
            points[frame, here] = transform_vectors(blend, positions) + blend[:, :, 3] - weight[:, None] * centres[frame]
            weights[frame, here] = weight
    pairs = _pairs(avatar, weights)
    needed = (3 * len(avatar.targets) + NUMBERS * count + LINEAR * len(pairs)) * 3 * vertices
    if needed > MOST_NUMBERS:
        raise InputError(
            f"{avatar.file.path}: {count} joints, of which {len(pairs)} pairs of a joint and a target move a vertex, need "
            f"{4e-9 * needed:.1f} GB: choose fewer with rig.joint_include=[NAME] or rig.include=[MESH]"
        )
    with_ones = np.concatenate([points, weights[:, :, None]], axis=2)
    parts = with_ones, _weighted_deltas(avatar, frames, pairs)
    rows = torch.cat([matrix_basis(torch.from_numpy(part).float()) for part in parts])
    check_distances(avatar.file, rows.numpy())
    return FrameBasis(rows, torch.tensor(pairs))


def frame_weights(basis: Float[Tensor, "coefficient vertex 3"], first: int, frames: int) -> Float[Tensor, "frame vertex"]:
    """The skin weights of frames, from the rows of a basis that begin at `first`."""
    return basis[first : first + NUMBERS * frames].view(frames, 3, 4, -1, 3)[:, 0, 3, :, 0]


def _pairs(avatar: Avatar, weights: np.ndarray) -> np.ndarray:
    """Frames and targets `(pair, 2)` that move common vertices."""
    sizes = np.linalg.norm(avatar.deltas, axis=2)
    found: list[tuple[int, int]] = []
    for frame, weight in enumerate(weights):
        moved_by_frame = np.flatnonzero(weight)
        moved = (sizes[:, moved_by_frame] * weight[moved_by_frame]).max(axis=1, initial=0.0) > NEGLIGIBLE_MM
        found += [(frame, int(target)) for target in np.flatnonzero(moved)]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _weighted_deltas(avatar: Avatar, frames: Frames, pairs: np.ndarray) -> np.ndarray:
    """Deltas of each pair's target, weighted by its frame, `(pair, vertex, 3)`, mm."""
    number_of = {(frame, target): number for number, (frame, target) in enumerate(pairs.tolist())}
    target_of = {name: number for number, name in enumerate(avatar.targets)}
    result = np.zeros((len(pairs), len(avatar.rest), 3), np.float32)
    for submesh in avatar.submeshes:
        binding, here = submesh.rest_binding(avatar.file, avatar.scene), avatar.vertex_map[submesh.vertices]
        frame_of = frames.of_node[binding.nodes]
        blends = {
            int(frame): blend_transforms(binding, np.flatnonzero(frame_of == frame), avatar.mm)
            for frame in np.unique(frame_of[frame_of >= 0])
        }
        for name, change in submesh.deltas(avatar.file):
            for frame, blend in blends.items():
                pair = number_of.get((frame, target_of[name]))
                if pair is not None:
                    result[pair, here] = transform_vectors(blend, change)
    return result
