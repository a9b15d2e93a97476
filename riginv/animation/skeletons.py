"""Joint transforms of an animation relative to their parents, for formats that hold skeletons."""

from typing import NamedTuple

import numpy as np
import torch

from riginv.animation.animation import Animation
from riginv.geometry.kinematics import Skeleton

BATCH_SIZE = 256  # frames at a time


class LocalPoses(NamedTuple):
    """Joint transforms relative to their parents.

    Attributes:
        rotations: `(frame, joint, 3, 3)`.
        translations: `(frame, joint, 3)`, mm, in the parent's axes; of a root, its position in the world.
    """

    rotations: np.ndarray
    translations: np.ndarray


@torch.no_grad()
def local_poses(skeleton: Skeleton, animation: Animation) -> LocalPoses:
    """The joint transforms of an animation; removed rigid motion is applied to the root."""
    worlds = torch.cat([skeleton.pose(batch) for batch in animation.controls.split(BATCH_SIZE)]).double().cpu()
    if animation.motion is not None:
        motion = animation.motion.double().cpu()[:, None]
        turned = motion[..., :3, :3] @ worlds
        worlds = torch.cat([turned[..., :3], turned[..., 3:] + motion[..., :3, 3:]], dim=-1)
    parents = torch.tensor(skeleton.parents)
    above = worlds[:, parents.clamp_min(0)]
    is_root = (parents < 0)[:, None, None]
    rotations = torch.where(is_root, worlds[..., :3], above[..., :3].mT @ worlds[..., :3])
    translations = torch.where(is_root, worlds[..., 3:], above[..., :3].mT @ (worlds[..., 3:] - above[..., 3:]))
    return LocalPoses(rotations.numpy(), translations[..., 0].numpy())
