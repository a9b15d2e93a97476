"""Joints whose rotations are quaternions: a product of the rotations of the columns of their group.

The order of the columns is that of the reference, which moves columns that a level of detail does not use to the end.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format.layers import JointGroup
from rigs.dna.logic.layout import Layout, Stage
from rigs.dna.logic.rotations import Angles, multiply, normalise

ROTATION = (3, 4, 5)  # of a joint's nine attributes


class QuaternionJoints(Stage):
    """The rotations of quaternion joints.

    Attributes:
        positions: indices of the joints among the evaluated ones, `(quaternion joint,)`.

    Args:
        blocks: used rows of each group.
        is_quaternion: whether each joint's rotation is a quaternion, `(joint,)`.
        joints: indices of the evaluated joints, `(joint,)`.

    Raises:
        InputError: the rotation of a joint is in two groups.
    """

    positions: Tensor
    inputs: Tensor
    rotations: Tensor

    def __init__(
        self,
        layout: Layout,
        blocks: Sequence[Any],
        groups: Sequence[JointGroup],
        is_quaternion: np.ndarray,
        joints: np.ndarray,
        angles: Angles,
    ) -> None:
        super().__init__()
        index_of = {int(joint): number for number, joint in enumerate(joints) if is_quaternion[joint]}
        self.keep(positions=np.array(list(index_of.values()), dtype=np.int64))
        columns: dict[int, list[tuple[int, np.ndarray]]] = {}
        owner: dict[int, int] = {}
        for number, (block, group) in enumerate(zip(blocks, groups)):
            rotations = _is_rotation(group.outputs, is_quaternion)
            order = column_order(group, rotations)
            for joint in np.unique(group.outputs[rotations] // 9).tolist():
                if owner.setdefault(joint, number) != number:
                    raise layout.wrong(f"the rotation of joint {joint}, a quaternion, is in groups {owner[joint]} and {number}")
                rows = block.outputs // 9 == joint
                values = np.zeros((3, len(order)))
                for row in np.flatnonzero(rows & _is_rotation(block.outputs, is_quaternion)):
                    values[block.outputs[row] % 9 - ROTATION[0]] = block.values[row, order]
                if joint in index_of:
                    moving = np.flatnonzero((values != 0).any(axis=0))
                    columns[joint] = [(int(block.inputs[order[column]]), values[:, column]) for column in moving]
        most = max((len(found) for found in columns.values()), default=0)
        layout.check_room("the quaternion joints", len(index_of), most, 4)
        inputs, eulers = np.full((len(index_of), most), layout.total), np.zeros((len(index_of), most, 3))
        for index, joint in enumerate(index_of):
            for slot, (source, euler) in enumerate(columns.get(joint, [])):
                inputs[index, slot], eulers[index, slot] = source, euler
        self.keep(inputs=inputs, rotations=angles.quaternions(torch.tensor(eulers)))

    def forward(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)` to quaternions `(batch, quaternion joint, 4)`."""
        count, most = self.inputs.shape
        identity = controls.new_tensor([0.0, 0.0, 0.0, 1.0])
        if not most:
            return identity.expand(len(controls), count, 4)
        padded = torch.cat([controls, controls.new_zeros(len(controls), 1)], dim=1)
        w = padded.index_select(1, self.inputs.flatten()).unflatten(1, (count, most))[..., None]
        rotations = self.rotations.to(controls)
        sign = torch.where(rotations[..., 3:] < 0, -1.0, 1.0)
        factors = normalise(w * rotations + sign * (1 - w) * identity)
        while factors.shape[2] > 1:  # product of all columns by pairwise reduction
            even = factors[:, :, : factors.shape[2] // 2 * 2].unflatten(2, (-1, 2))
            product = multiply(even[:, :, :, 1], even[:, :, :, 0])
            factors = torch.cat([product, factors[:, :, even.shape[2] * 2 :]], dim=2)
        return factors[:, :, 0]


def _is_rotation(outputs: np.ndarray, is_quaternion: np.ndarray) -> np.ndarray:
    """Whether attributes are angles of quaternion joints."""
    return is_quaternion[outputs // 9] & np.isin(outputs % 9, ROTATION)


def column_order(group: JointGroup, rotations: np.ndarray) -> np.ndarray:
    """Order in which the reference multiplies the non-zero columns of a group.

    Args:
        rotations: mask of the rows that are angles of quaternion joints.
    """
    values = group.values.reshape(len(group.outputs), len(group.inputs)) != 0
    values &= rotations[:, None]
    order = np.flatnonzero(values.any(axis=0))
    first_row = values[:, order].argmax(axis=0)  # a level that uses fewer rows does not use the column
    end = len(order) - 1
    for count in dict.fromkeys(group.row_counts.tolist()):
        for column in range(end, -1, -1):
            if first_row[column] >= count:
                for one in (order, first_row):
                    one[[column, end]] = one[[end, column]]
                end -= 1
    return order
