"""The motion of nodes in the animations of a file, from which joint controls get their ranges."""

from typing import NamedTuple

import numpy as np
import roma
import torch

from riginv.errors import InputError
from rigs.gltf.animation import ROTATION, SCALE, STEP, TRANSLATION, Channel
from rigs.gltf.channels import animation_names, read_channels
from rigs.gltf.container import GltfFile
from rigs.gltf.scene import Scene

MOST_SAMPLES = 2048  # of a channel
BETWEEN = 3  # samples between two keys
ANGLE = 1e-4  # radians, translations relative to the mesh, and scales: smaller differences from rest are no motion


class NodeMotion(NamedTuple):
    """The motion of a node in one animation, relative to its rest transform; None for what it does not move.

    Attributes:
        rotations: `(sample, 3, 3)`, after the rotation at rest.
        translations: `(sample, 3)`, in the parent's axes and units.
        scales: `(sample, 3)`, as multiples of those at rest.
    """

    rotations: np.ndarray | None = None
    translations: np.ndarray | None = None
    scales: np.ndarray | None = None


def node_motions(file: GltfFile, scene: Scene, tolerance: float) -> dict[int, list[NodeMotion]]:
    """The motions of all nodes that any animation takes away from rest; animations that cannot be read are noted.

    Args:
        tolerance: of translations, in units of the file.
    """
    found: dict[int, list[NodeMotion]] = {}
    for number, name in enumerate(animation_names(file)):
        try:
            channels = read_channels(file, number)
        except InputError as error:
            file.note(f"Animation '{name}' gives the joints no limits, as it cannot be read: {error}")
            continue
        of_node: dict[int, NodeMotion] = {}
        for channel in channels:
            moved = _relative(scene, channel, tolerance)
            if moved is not None:
                before = of_node.get(channel.node, NodeMotion())
                of_node[channel.node] = before._replace(**{f"{channel.path}s": moved})
        for node, motion in of_node.items():
            found.setdefault(node, []).append(motion)
    return found


def _relative(scene: Scene, channel: Channel, tolerance: float) -> np.ndarray | None:
    """Samples of a channel relative to rest; None where they stay there."""
    if channel.path not in (ROTATION, TRANSLATION, SCALE):
        return None
    values = channel.at(_times(channel))
    rigid, scaling = scene.rigid[channel.node].numpy(), scene.scaling[channel.node].numpy()
    if channel.path == ROTATION:
        quaternions = torch.tensor(values / np.linalg.norm(values, axis=1, keepdims=True).clip(1e-9))
        rotations = rigid[:, :3].T @ roma.unitquat_to_rotmat(quaternions).numpy()
        return rotations if np.abs(rotations - np.eye(3)).max() > ANGLE else None
    if channel.path == TRANSLATION:
        away = values - rigid[:, 3]
        return away if np.abs(away).max() > tolerance else None
    rest = np.diag(scaling[:, :3])
    if np.abs(rest).min() < 1e-9:
        return None
    return values / rest if np.abs(values / rest - 1).max() > ANGLE else None


def _times(channel: Channel) -> np.ndarray:
    """Times of the keys and, unless values jump, some between them."""
    keys = channel.times
    if channel.interpolation != STEP and len(keys) > 1:
        parts = [keys[:-1] + part * np.diff(keys) for part in np.arange(1, BETWEEN + 1) / (BETWEEN + 1)]
        keys = np.unique(np.concatenate([keys, *parts]))
    return keys[np.unique(np.linspace(0, len(keys) - 1, MOST_SAMPLES).round().astype(int))]
