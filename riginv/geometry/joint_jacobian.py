"""The geometric Jacobian of forward kinematics: the derivative of joint transforms by controls that rotate joints.

A control that rotates a joint about an axis moves all of its descendants as one rigid body; rotations of several joints add up.
So the derivative follows from the axes, and is zero for joints that are not below one that the control rotates.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn


class JointJacobian(nn.Module):
    """The derivative of the world transforms of some joints by controls that rotate joints.

    Args:
        parents: of each joint, -1 for a root.
        angles: radians for each unit of a control, `(control, 3 * joint)`: about the three axes of each joint.
        joints: those whose transforms are returned, `(wanted,)`.
    """

    axis: Tensor
    angle: Tensor
    of_entry: Tensor
    pair_control: Tensor
    pair_joint: Tensor
    joints: Tensor
    parents: Tensor

    def __init__(self, parents: Sequence[int], angles: Float[Tensor, "control angle"], joints: Int[Tensor, " wanted"]) -> None:
        super().__init__()
        control, axis = angles.nonzero(as_tuple=True)
        carried = _ancestry(parents)[axis // 3][:, joints]
        entry, wanted = carried.nonzero(as_tuple=True)
        pairs, of_entry = torch.unique(control[entry] * len(joints) + wanted, return_inverse=True)
        buffers = {
            "axis": axis[entry],
            "angle": angles[control[entry], axis[entry]],
            "of_entry": of_entry,
            "pair_control": pairs // len(joints),
            "pair_joint": pairs % len(joints),
            "joints": joints,
            "parents": torch.tensor(parents),
        }
        for name, tensor in buffers.items():
            self.register_buffer(name, tensor, persistent=False)
        self.controls = len(angles)

    def forward(
        self, worlds: Float[Tensor, "batch joint 3 4"], axes: Float[Tensor, "batch joint 3 3"]
    ) -> Float[Tensor, "batch control wanted 3 4"]:
        """The derivative of the transforms, `(batch, control, wanted, 3, 4)`.

        Args:
            worlds: all joints' transforms.
            axes: the three rotation axes of each joint, as columns, in its parent's frame.
        """
        rotations, positions = worlds[..., :3], worlds[..., 3]
        above = rotations[:, self.parents.clamp_min(0)]
        above = torch.where((self.parents < 0)[:, None, None], torch.eye(3).to(worlds), above)
        spins = (above @ axes).mT  # (batch, joint, axis, 3)
        moments = torch.linalg.cross(positions[:, :, None].expand_as(spins), spins)
        spin, moment = (self._summed(values.flatten(1, 2)) for values in (spins, moments))
        wanted = worlds[:, self.joints][:, self.pair_joint]
        derivatives = torch.linalg.cross(spin[..., None].expand_as(wanted), wanted, dim=2)
        derivatives[..., 3] += moment
        result = worlds.new_zeros(len(worlds), self.controls, len(self.joints), 3, 4)
        result[:, self.pair_control, self.pair_joint] = derivatives
        return result

    def _summed(self, vectors: Tensor) -> Tensor:
        """The sum of vectors `(batch, 3 * joint, 3)` times angles, per pair of control and joint: `(batch, pair, 3)`."""
        entries = self.angle.to(vectors)[:, None] * vectors[:, self.axis]
        return vectors.new_zeros(len(vectors), len(self.pair_control), 3).index_add_(1, self.of_entry, entries)


def _ancestry(parents: Sequence[int]) -> Tensor:
    """Whether a joint is an ancestor of another, or the same: `(ancestor, joint)`."""
    carries = torch.eye(len(parents), dtype=torch.bool)
    for joint in range(len(parents)):
        above = parents[joint]
        while above >= 0:
            carries[above, joint] = True
            above = parents[above]
    return carries
