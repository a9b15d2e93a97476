"""From joint angles to coefficients: changes of the joint matrices, alone and times morph weights."""

import roma
import torch
from torch import Tensor, nn

from riginv.geometry.kinematics import compose, forward_kinematics, invert, transform_from, tree_levels
from riginv.geometry.skinning import NUMBERS
from rigs.gltf.frames import LINEAR, Frames

ANGLES = ("rx", "ry", "rz")
AXES = 3  # of space
ORDER = "XYZ"  # intrinsic: R = Rx Ry Rz


class JointMotion(nn.Module):
    """Forward kinematics of frames.

    A frame moves its vertices by a 3x4 matrix M about its rest position c: x - c goes to M (x - c), and the change of the
    translation is the displacement of c. All coefficients are 0 at rest, and each moves vertices along one axis only: weights
    of targets are repeated three times, so that a mesh space can be computed axis by axis.

    Args:
        frames: as from `joint_frames`.
        pairs: `(pair, 2)`, as from `frame_basis`.
    """

    rest: Tensor
    inverse_rest: Tensor
    pairs: Tensor

    def __init__(self, frames: Frames, pairs: Tensor) -> None:
        super().__init__()
        self.parents = frames.parents
        self.levels = tree_levels(frames.parents, frames.names)
        self.register_buffer("rest", frames.rest.float(), persistent=False)
        self.register_buffer("inverse_rest", invert(frames.rest).float(), persistent=False)
        self.register_buffer("pairs", pairs, persistent=False)

    def forward(self, weights: Tensor, degrees: Tensor) -> Tensor:
        """Weights `(batch, target)` and angles `(batch, 3 frame)` to coefficients `(batch, 3 target + 12 frame + 9 pair)`."""
        rotations = roma.euler_to_rotmat(ORDER, degrees.unflatten(1, (-1, 3)), degrees=True)
        local = transform_from(rotations, rotations.new_zeros(rotations.shape[:3]))
        rest, inverse_rest = self.rest.to(rotations), self.inverse_rest.to(rotations)
        world = forward_kinematics(compose(compose(rest, local), inverse_rest), self.parents, self.levels)
        centres = rest[..., 3:]
        linear = world[..., :3] - torch.eye(3).to(rotations)
        moved = linear @ centres + world[..., 3:]
        matrices = torch.cat([linear, moved], dim=-1).flatten(2)
        products = linear.flatten(2)[:, self.pairs[:, 0]] * weights[:, self.pairs[:, 1], None]
        return torch.cat([weights.repeat_interleave(AXES, dim=1), matrices.flatten(1), products.flatten(1)], dim=1)


def coefficient_names(frames: Frames, pairs: Tensor, targets: list[str]) -> list[str]:
    """Names of the coefficients of `JointMotion`: joint, row and column, and the target, if any."""
    full = [f"{row}{column}" for row in range(3) for column in range(NUMBERS // 3)]
    linear = [f"{row}{column}" for row in range(3) for column in range(LINEAR // 3)]
    morphs = [f"{name}.{axis}" for name in targets for axis in "xyz"]
    joints = [f"{name}.{entry}" for name in frames.names for entry in full]
    both = [f"{frames.names[frame]}.{entry} {targets[target]}" for frame, target in pairs.tolist() for entry in linear]
    return morphs + joints + both
