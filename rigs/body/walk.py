"""A walk to evaluate inverses on, made for MakeHuman's skeleton in Blender (`rigs.geometry.anny.walk` says how it was read)."""

import torch
from torch import Tensor

from rigs.geometry.asset import read_asset

FPS = 60.0


def walk() -> tuple[Tensor, Tensor]:
    """The rotations of each joint against its parent, `(frame, joint, 3, 3)`, and the move of the root, `(frame, 3)`, mm."""
    arrays = read_asset()
    move = torch.tensor(arrays["walk_move"])
    rotations = torch.eye(3).repeat(len(move), len(arrays["joint_parents"]), 1, 1)
    rotations[:, torch.tensor(arrays["walk_joints"].astype("int64"))] = torch.tensor(arrays["walk_rotations"])
    return rotations, move
