"""The exact linear map of DNA rigs with few moving joints: coefficients and basis.

Vertices are the rest mesh plus, for each moving joint, the 12 entries by which its skinning matrix about its rest position
differs from the identity; plus the weight of each channel; plus, for each joint and channel with common vertices, the 9
entries of the rotation times the weight. Without moving joints the coefficients are the weights of channels.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from riginv.geometry.skinning import NUMBERS, by_axis, matrix_basis
from riginv.rig.joint_features import JointFeatures, JointFreedom, SkinFeatures
from rigs.dna.logic.layout import Stage
from rigs.dna.model import Model, Pose

LINEAR = 9  # entries of a matrix that rotate deltas
MOST_COEFFICIENTS = 1500
MOST_NUMBERS = 100_000_000  # of a basis
LEAST_WEIGHT = 0.25  # greatest skin weight of a joint: with less it has no vertices that show its rotation
MOVES, SCALES = slice(3), slice(6, 9)  # of a joint's nine attributes
NEGLIGIBLE_MM = 1e-4  # a joint whose fraction of a channel's deltas stays below this does not rotate them


@dataclass(frozen=True)
class LinearMap:
    """The linear map of a rig.

    Attributes:
        basis: `(coefficient, vertex, 3)` float32, mm.
        names: of the coefficients.
        stage: from a `Pose` to coefficients `(batch, coefficient)`.
        channels: number of coefficients where all are weights of channels; 0 where joints move.
    """

    basis: Tensor
    names: list[str]
    stage: Stage
    channels: int


class Coefficients(Stage):
    """From a pose to coefficients.

    Args:
        moving: indices of the joints of the model that move and have skin weights, `(moving,)`.
        centres: their rest positions, `(moving, 3)`, mm.
        pairs: `(pair, 2)`: indices into `moving` and into the channels.
    """

    moving: Tensor
    centres: Tensor
    pairs: Tensor

    def __init__(self, moving: np.ndarray, centres: np.ndarray, pairs: np.ndarray) -> None:
        super().__init__()
        self.keep(moving=moving, centres=torch.tensor(centres), pairs=pairs.reshape(-1, 2))

    def forward(self, pose: Pose) -> Tensor:
        """Coefficients `(batch, coefficient)`."""
        weights = pose.channels
        if not len(self.moving):
            return weights
        matrices = pose.matrices.index_select(0, self.moving).movedim(-1, 0)
        linear = matrices[..., :3] - torch.eye(3, dtype=matrices.dtype, device=matrices.device)
        displacement = linear @ self.centres.to(linear)[..., None] + matrices[..., 3:]
        joints = torch.cat([linear, displacement], dim=-1).flatten(1)
        rotated = linear.flatten(2)[:, self.pairs[:, 0]] * weights[:, self.pairs[:, 1], None]
        return torch.cat([weights.repeat_interleave(3, dim=1), joints, rotated.flatten(1)], dim=1)


def skin_features(model: Model, stage: Coefficients) -> SkinFeatures:
    """The features of coefficients: weights of channels, and the motion of joints relative to their parents."""
    count, weights = len(model.joints), model.skin.weights[:, : len(model.joints)]
    weight = np.asarray(weights.sum(axis=0)).reshape(-1)
    weight[weights.max(axis=0).toarray().reshape(-1) < LEAST_WEIGHT] = 0.0
    weight[~_can_move(model)] = 1.0  # their rotation is known
    rows = model.logic.joints.groups.rows_of_attributes.view(count, -1) < rows_of(model)
    moved, scaled = (rows[:, part].any(dim=1).nonzero()[:, 0] for part in (MOVES, SCALES))
    orders = torch.tensor([model.logic.joints.angles.sequence[::-1]] * count)
    moves, scales = (
        (moved, torch.eye(3).repeat(len(moved), 1, 1)),
        (scaled.repeat_interleave(3), torch.eye(3).repeat(len(scaled), 1)),
    )
    freedom = JointFreedom(model.skeleton.parents, model.skeleton.neutral.float(), orders, *moves, *scales)
    size = max(float(np.ptp(model.skin.rest, axis=0).max()), 1e-6)
    joints = JointFeatures(freedom, torch.tensor(weight), size)
    return SkinFeatures(joints, stage.moving, len(model.channels), stage.pairs)


def rows_of(model: Model) -> int:
    """The number of rows of a model's joint groups: attributes with a greater row are never changed."""
    groups = model.logic.joints.groups
    return sum(groups.get_buffer(f"values{number}").shape[0] for number in range(len(groups.widths)))


def _can_move(model: Model) -> np.ndarray:
    """Whether each joint of a model can move, `(joint,)`."""
    stage, count = model.logic.joints, len(model.joints)
    moves = (
        (stage.groups.rows_of_attributes.view(count, -1) < rows_of(model)).any(dim=1).numpy() if count else np.zeros(0, bool)
    )
    moves[stage.quaternion_joints.numpy()] = True
    parents = np.array(model.skeleton.parents, dtype=np.int64)
    for level in model.skeleton.levels[1:]:
        moves[level] |= moves[parents[level]]
    return moves


def moving_joints(model: Model) -> np.ndarray:
    """Indices of the joints of a model that can move and have skin weights."""
    weights, count = model.skin.weights, len(model.joints)
    skinned = np.bincount(weights.indices, weights.data, minlength=count + 1)[:count] > 0
    return np.flatnonzero(_can_move(model) & skinned)


def linear_map(model: Model, channel_names: list[str]) -> LinearMap | None:
    """The linear map of a model; None where it would be too large."""
    moving, channels = moving_joints(model), len(model.channels)
    vertices = len(model.surface.rest)
    if not _fits((3 if len(moving) else 1) * channels + NUMBERS * len(moving), vertices):
        return None
    weights = sparse.csc_array(model.skin.weights)[:, moving].toarray()  # (vertex, moving)
    deltas = model.skin.deltas.toarray().T.reshape(channels, vertices, 3).astype(np.float32)
    names = [channel_names[number] for number in model.channels]
    if not len(moving):
        stage = Coefficients(moving, np.zeros((0, 3)), np.zeros((0, 2), np.int64))
        return LinearMap(torch.tensor(deltas), names, stage, channels)
    sizes = np.linalg.norm(deltas, axis=2)
    pairs = np.array(
        [
            (joint, channel)
            for joint in range(len(moving))
            for channel in np.flatnonzero((sizes * weights[:, joint]).max(axis=1, initial=0.0) > NEGLIGIBLE_MM)
        ],
        dtype=np.int64,
    ).reshape(-1, 2)
    if not _fits(3 * channels + NUMBERS * len(moving) + LINEAR * len(pairs), vertices):
        return None
    centres = model.skeleton.neutral[moving, :, 3].numpy()
    offsets = model.skin.rest[None] - centres[:, None]
    points = np.concatenate([offsets, np.ones((*offsets.shape[:2], 1))], axis=2) * weights.T[..., None]
    rotated = deltas[pairs[:, 1]] * weights.T[pairs[:, 0], :, None]
    moved = (matrix_basis(torch.from_numpy(part).float()) for part in (points, rotated))
    basis = torch.cat([by_axis(torch.from_numpy(deltas).float()), *moved])
    joints = [f"joint {int(model.joints[joint])}" for joint in moving]
    names = [
        *(f"{name}.{axis}" for name in names for axis in "xyz"),
        *(f"{joint}.{row}{column}" for joint in joints for row in range(3) for column in range(4)),
        *(f"{joints[j]}.{row}{column} {names[c]}" for j, c in pairs for row in range(3) for column in range(3)),
    ]
    return LinearMap(basis, names, Coefficients(moving, centres, pairs), 0)


def _fits(coefficients: int, vertices: int) -> bool:
    return coefficients <= MOST_COEFFICIENTS and 3 * coefficients * vertices <= MOST_NUMBERS
