"""The body's geometry and walk as tensors, from the asset."""

import numpy as np
import torch
from torch import Tensor

from rigs.geometry.asset import POSITION_MM, read_asset


def body_geometry() -> dict[str, Tensor]:
    """The tensors of the body.

    Returns:
        rest_vertices `(vertex, 3)`, mm; faces `(face, 3)`; weights `(vertex, joint)`; parents `(joint,)`; heads and tails
        `(joint, 3)`, mm; rolls `(joint,)`; frames `(joint, 3, 3)`, as `rigs.body.skeleton.joint_frames` has them.
    """
    arrays = read_asset()
    positions, parents = arrays["body_positions"], arrays["joint_parents"]
    weights = np.zeros((len(positions), len(parents)))
    weights[arrays["weight_vertex"], arrays["weight_joint"]] = arrays["weight"]
    return {
        "rest_vertices": torch.tensor(positions * POSITION_MM, dtype=torch.float32),
        "faces": torch.tensor(arrays["body_faces"].astype(np.int64)),
        "weights": torch.tensor(weights, dtype=torch.float32),
        "parents": torch.tensor(parents.astype(np.int64)),
        "heads": torch.tensor(arrays["joint_heads"], dtype=torch.float32),
        "tails": torch.tensor(arrays["joint_tails"], dtype=torch.float32),
        "rolls": torch.tensor(arrays["joint_rolls"], dtype=torch.float32),
        "frames": torch.tensor(arrays["joint_frames"], dtype=torch.float64),
    }


FPS = 60.0


def walk() -> tuple[Tensor, Tensor]:
    """A walk: rotations of each joint relative to its parent, `(frame, joint, 3, 3)`, and root displacement `(frame, 3)`, mm.

    Made for MakeHuman's skeleton in Blender (`rigs.geometry.anny.walk`).
    """
    arrays = read_asset()
    move = torch.tensor(arrays["walk_move"])
    rotations = torch.eye(3).repeat(len(move), len(arrays["joint_parents"]), 1, 1)
    rotations[:, torch.tensor(arrays["walk_joints"].astype("int64"))] = torch.tensor(arrays["walk_rotations"])
    return rotations, move
