"""From the angles of joints to coefficients: what their matrices are more than at rest, alone and times the morph weights."""

import roma
import torch
from torch import Tensor, nn

from riginv.geometry.kinematics import compose, forward_kinematics, invert, transform_from, tree_levels
from riginv.geometry.skinning import NUMBERS
from rigs.gltf.frames import LINEAR, Frames

ANGLES = ("rx", "ry", "rz")
AXES_IN_SPACE = 3
ORDER = "XYZ"  # of the angles, each about the axes as the one before left them: R = Rx Ry Rz


class JointMotion(nn.Module):
    """Forward kinematics of frames.

    A frame carries its vertices by a 3x4 matrix M about its place c at rest: x - c goes to M (x - c), and the change of the
    translation is where c itself goes. All coefficients are 0 at rest, and each moves vertices along one axis of space only:
    the weights of targets come three times, so that a mesh space can be found axis by axis.

    Args:
        frames: as from `joint_frames`.
        pairs: `(pair, 2)`, as from `frame_basis`.
    """

    places: Tensor
    back: Tensor
    pairs: Tensor

    def __init__(self, frames: Frames, pairs: Tensor) -> None:
        super().__init__()
        self.parents = frames.parents
        self.levels = tree_levels(frames.parents, frames.names)
        self.register_buffer("places", frames.places.float(), persistent=False)
        self.register_buffer("back", invert(frames.places).float(), persistent=False)
        self.register_buffer("pairs", pairs, persistent=False)

    def forward(self, weights: Tensor, degrees: Tensor) -> Tensor:
        """Weights `(batch, target)` and angles `(batch, 3 frame)` to coefficients `(batch, 3 target + 12 frame + 9 pair)`."""
        turns = roma.euler_to_rotmat(ORDER, degrees.unflatten(1, (-1, 3)), degrees=True)
        local = transform_from(turns, turns.new_zeros(turns.shape[:3]))
        places, back = self.places.to(turns), self.back.to(turns)
        world = forward_kinematics(compose(compose(places, local), back), self.parents, self.levels)
        centres = places[..., 3:]
        linear = world[..., :3] - torch.eye(3).to(turns)
        moved = linear @ centres + world[..., 3:]
        matrices = torch.cat([linear, moved], dim=-1).flatten(2)
        turned = linear.flatten(2)[:, self.pairs[:, 0]] * weights[:, self.pairs[:, 1], None]
        return torch.cat([weights.repeat_interleave(AXES_IN_SPACE, dim=1), matrices.flatten(1), turned.flatten(1)], dim=1)


def by_axis(deltas: Tensor) -> Tensor:
    """Deltas `(target, vertex, 3)` as three rows each, `(3 target, vertex, 3)`, one for every axis of space."""
    return (deltas[:, None] * torch.eye(AXES_IN_SPACE)[:, None]).flatten(0, 1)


def coefficient_names(frames: Frames, pairs: Tensor, targets: list[str]) -> list[str]:
    """The names of what `JointMotion` gives, in its order: joint, row and column, and the target where there is one."""
    full = [f"{row}{column}" for row in range(3) for column in range(NUMBERS // 3)]
    linear = [f"{row}{column}" for row in range(3) for column in range(LINEAR // 3)]
    morphs = [f"{name}.{axis}" for name in targets for axis in "xyz"]
    alone = [f"{name}.{place}" for name in frames.names for place in full]
    both = [f"{frames.names[frame]}.{place} {targets[target]}" for frame, target in pairs.tolist() for place in linear]
    return morphs + alone + both
