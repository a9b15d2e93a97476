"""The joints that become controls, as frames: each carries what hangs on it and on the other nodes below it."""

from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.geometry.kinematics import compose
from riginv.geometry.skinning import NUMBERS
from rigs.gltf.accessors import MOST_NUMBERS
from rigs.gltf.avatar import Avatar, blended, check_distances, turned

NEGLIGIBLE_MM = 1e-4  # a joint whose share of a target's deltas stays below this does not turn them
LINEAR = 9  # numbers of the 3x4 matrix of a joint that turn deltas: its last column moves points only


class Frames(NamedTuple):
    """Joints with controls.

    Attributes:
        names: of the joints.
        parents: the frame that carries each, -1 where none does.
        places: `(frame, 3, 4)`: the coordinates that each turns in, in the world at rest, mm.
        of_node: the frame that carries each node of the scene, -1 where none does.
    """

    names: list[str]
    parents: list[int]
    places: Tensor
    of_node: np.ndarray


class FrameBasis(NamedTuple):
    """What the numbers of the frames' matrices are multiplied with.

    Attributes:
        rows: `(12 frame + 9 pair, vertex, 3)` float32, mm.
        pairs: `(pair, 2)` int64: the frame and the target whose deltas it turns.
    """

    rows: Tensor
    pairs: Tensor


def joint_frames(avatar: Avatar, include: list[str]) -> Frames:
    """The joints of the avatar's skins that globs name and that carry any vertex, themselves or by what hangs on them.

    Raises:
        InputError: there are none, or one of them stands in a space that is flat.
    """
    scene, file = avatar.scene, avatar.file
    skins = {file.document["nodes"][piece.node].get("skin") for piece in avatar.pieces} - {None}
    joints = {joint for skin in skins for joint in file.item("skins", skin, "a node")["joints"]}
    loaded = _loaded(avatar)
    named = [j for j in joints if loaded[j] and any(fnmatchcase(scene.names[j], glob) for glob in include)]
    if not named:
        known = ", ".join(scene.names[joint] for joint in sorted(joints) if loaded[joint])[:300] or "none"
        raise InputError(
            f"{file.path}: rig.joint_include={include} names no joint that moves a vertex; its joints are: {known}"
        )
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
    return Frames([scene.names[node] for node in order], parents, _places(avatar, order), of_node)


def _places(avatar: Avatar, nodes: list[int]) -> Tensor:
    scene, places = avatar.scene, []
    for node in nodes:
        parent = scene.parents[node]
        place = scene.turning[node] if parent < 0 else compose(scene.world[parent], scene.turning[node])
        if abs(float(torch.linalg.det(place[:, :3]))) < 1e-12:
            raise InputError(
                f"{avatar.file.path}: joint '{scene.names[node]}' stands in a space that is scaled to nothing: leave it out of "
                f"rig.joint_include, or export it with another scale"
            )
        places.append(torch.cat([place[:, :3], place[:, 3:] * avatar.mm], dim=1))
    return torch.stack(places)


def _loaded(avatar: Avatar) -> np.ndarray:
    """Whether each node carries a vertex, itself or by a node below it, `(node,)`."""
    loaded = np.zeros(len(avatar.scene.names), bool)
    for piece in avatar.pieces:
        carriers = piece.carriers(avatar.file, avatar.scene)
        loaded[carriers.nodes[(carriers.shares > 0).any(axis=0)]] = True
    for level in reversed(avatar.scene.levels):
        for node in level.tolist():
            if avatar.scene.parents[node] >= 0:
                loaded[avatar.scene.parents[node]] |= loaded[node]
    return loaded


def frame_basis(avatar: Avatar, frames: Frames) -> FrameBasis:
    """The basis of the frames' matrices, each about its joint's place at rest, and of these times the morph weights.

    Raises:
        InputError: it would not fit in memory.
    """
    count, vertices = len(frames.names), len(avatar.rest)
    points, shares = np.zeros((count, vertices, 3), np.float32), np.zeros((count, vertices), np.float32)
    centres = frames.places[:, :, 3].numpy()
    for piece in avatar.pieces:
        carriers, here = piece.carriers(avatar.file, avatar.scene), avatar.vertex_map[piece.vertices]
        positions, of_carrier = piece.positions(avatar.file), frames.of_node[carriers.nodes]
        for frame in np.unique(of_carrier[of_carrier >= 0]):
            some = np.flatnonzero(of_carrier == frame)
            blend, share = blended(carriers, some, avatar.mm), carriers.shares[:, some].sum(axis=1)
            points[frame, here] = turned(blend, positions) + blend[:, :, 3] - share[:, None] * centres[frame]
            shares[frame, here] = share
    pairs = _pairs(avatar, shares)
    needed = (3 * len(avatar.targets) + NUMBERS * count + LINEAR * len(pairs)) * 3 * vertices
    if needed > MOST_NUMBERS:
        raise InputError(
            f"{avatar.file.path}: {count} joints, of which {len(pairs)} pairs of a joint and a target move a vertex, need "
            f"{4e-9 * needed:.1f} GB: choose fewer with rig.joint_include=[NAME] or rig.include=[MESH]"
        )
    with_ones = np.concatenate([points, shares[:, :, None]], axis=2)
    rows = np.concatenate([_rows(with_ones), _rows(_turned_deltas(avatar, frames, pairs))])
    check_distances(avatar.file, rows)
    return FrameBasis(torch.tensor(rows), torch.tensor(pairs))


def _pairs(avatar: Avatar, shares: np.ndarray) -> np.ndarray:
    """The frames and targets `(pair, 2)` that have vertices in common."""
    sizes = np.linalg.norm(avatar.deltas, axis=2)
    found = []
    for frame, share in enumerate(shares):
        carried = np.flatnonzero(share)
        moved = (sizes[:, carried] * share[carried]).max(axis=1, initial=0.0) > NEGLIGIBLE_MM
        found += [(frame, target) for target in np.flatnonzero(moved)]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _turned_deltas(avatar: Avatar, frames: Frames, pairs: np.ndarray) -> np.ndarray:
    """The share of each pair's frame in the deltas of its target, `(pair, vertex, 3)`, mm."""
    number_of = {(frame, target): number for number, (frame, target) in enumerate(pairs.tolist())}
    place = {name: number for number, name in enumerate(avatar.targets)}
    result = np.zeros((len(pairs), len(avatar.rest), 3), np.float32)
    for piece in avatar.pieces:
        carriers, here = piece.carriers(avatar.file, avatar.scene), avatar.vertex_map[piece.vertices]
        of_carrier = frames.of_node[carriers.nodes]
        blends = {
            int(frame): blended(carriers, np.flatnonzero(of_carrier == frame), avatar.mm)
            for frame in np.unique(of_carrier[of_carrier >= 0])
        }
        for name, change in piece.deltas(avatar.file):
            for frame, blend in blends.items():
                pair = number_of.get((frame, place[name]))
                if pair is not None:
                    result[pair, here] = turned(blend, change)
    return result


def _rows(points: np.ndarray) -> np.ndarray:
    """The basis `(item * 3 * column, vertex, 3)` of matrices, row by row, that act on `(item, vertex, column)`."""
    items, vertices, columns = points.shape
    rows = np.zeros((items, 3, columns, vertices, 3), np.float32)
    for axis in range(3):
        rows[:, axis, :, :, axis] = points.transpose(0, 2, 1)
    return rows.reshape(items * 3 * columns, vertices, 3)
