"""How joints move as controls turn the joints above them: the derivative of forward kinematics, as a person would write it.

A control that turns a joint about an axis through its place moves whatever hangs from it as one rigid piece; turns of several
joints add up. So the derivative is known from the axes alone, and only for the joints below those that a control turns.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn


class JointSlopes(nn.Module):
    """The derivative of the world transforms of some joints by controls that turn joints.

    Args:
        parents: of each joint, -1 for a root.
        angles: radians for each unit of a control, `(control, 3 * joint)`: about the three axes of each joint.
        wanted: the joints whose transforms matter, `(wanted,)`.
    """

    def __init__(self, parents: Sequence[int], angles: Tensor, wanted: Tensor) -> None:
        super().__init__()
        control, turn = angles.nonzero(as_tuple=True)
        carried = _ancestry(parents)[turn // 3][:, wanted]
        entry, place = carried.nonzero(as_tuple=True)
        pairs, of_entry = torch.unique(control[entry] * len(wanted) + place, return_inverse=True)
        buffers = {
            "turn": turn[entry],
            "share": angles[control[entry], turn[entry]],
            "of_entry": of_entry,
            "pair_control": pairs // len(wanted),
            "pair_place": pairs % len(wanted),
            "wanted": wanted,
            "parents": torch.tensor(parents),
        }
        for name, tensor in buffers.items():
            self.register_buffer(name, tensor, persistent=False)
        self.controls = len(angles)

    def forward(self, worlds: Tensor, axes: Tensor) -> Tensor:
        """The derivative of the wanted transforms, `(batch, control, wanted, 3, 4)`.

        Args:
            worlds: all joints' transforms, `(batch, joint, 3, 4)`.
            axes: of each joint's three turns, as columns, in the frame of its parent's rotation: `(batch, joint, 3, 3)`.
        """
        rotations, places = worlds[..., :3], worlds[..., 3]
        above = rotations[:, self.parents.clamp_min(0)]
        above = torch.where((self.parents < 0)[:, None, None], torch.eye(3).to(worlds), above)
        spins = (above @ axes).mT  # (batch, joint, turn, 3)
        moments = torch.linalg.cross(places[:, :, None].expand_as(spins), spins)
        spin, moment = (self._summed(values.flatten(1, 2)) for values in (spins, moments))
        wanted = worlds[:, self.wanted][:, self.pair_place]
        derivatives = torch.linalg.cross(spin[..., None].expand_as(wanted), wanted, dim=2)
        derivatives[..., 3] += moment
        result = worlds.new_zeros(len(worlds), self.controls, len(self.wanted), 3, 4)
        result[:, self.pair_control, self.pair_place] = derivatives
        return result

    def _summed(self, turns: Tensor) -> Tensor:
        """Of turns `(batch, 3 * joint, 3)` the sum that each control makes of them for each joint, `(batch, pair, 3)`."""
        entries = self.share.to(turns)[:, None] * turns[:, self.turn]
        return turns.new_zeros(len(turns), len(self.pair_control), 3).index_add_(1, self.of_entry, entries)


def _ancestry(parents: Sequence[int]) -> Tensor:
    """Whether one joint carries another, or is it: `(carrying, carried)`."""
    carries = torch.eye(len(parents), dtype=torch.bool)
    for joint in range(len(parents)):
        above = parents[joint]
        while above >= 0:
            carries[above, joint] = True
            above = parents[above]
    return carries
