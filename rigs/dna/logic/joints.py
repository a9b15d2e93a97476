"""Joint groups: from controls to changes of translation, rotation and scale of joints."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format import DnaFile
from rigs.dna.format.later_layers import JointRepresentations
from rigs.dna.format.layers import Behavior, Definition, JointGroup
from rigs.dna.logic.layout import Layout, Stage
from rigs.dna.logic.quaternion_joints import ROTATION, QuaternionJoints
from rigs.dna.logic.rotations import Angles

ATTRIBUTES = 9
QUATERNION = 1  # of a joint's representation of rotation


class JointChanges(NamedTuple):
    """Changes of joints relative to their neutral pose; the batch is last for speed (`rigs.dna.geometry.skeleton`).

    Attributes:
        attributes: `(joint, 9, batch)` in the file's units: translation, Euler angles, scale less 1.
        quaternions: `(batch, quaternion joint, 4)`: rotations of joints that have quaternions in place of Euler angles.
        quaternion_joints: those joints, `(quaternion joint,)`.
    """

    attributes: Tensor
    quaternions: Tensor
    quaternion_joints: Tensor


class Block(NamedTuple):
    """The used rows of a group, and the columns that are non-zero in them."""

    inputs: np.ndarray
    outputs: np.ndarray
    values: np.ndarray


class JointGroups(Stage):
    """Evaluates the joint groups of a level of detail.

    Args:
        joints: indices of the joints to evaluate, `(joint,)`, in the order of the results.

    Raises:
        InputError: a group is damaged.
    """

    inputs: Tensor
    rows_of_attributes: Tensor

    def __init__(self, file: DnaFile, layout: Layout, lod: int, joints: np.ndarray) -> None:
        super().__init__()
        groups = file.need(Behavior).joints.groups
        blocks = [group_block(file, layout, number, lod) for number in range(len(groups))]
        is_quaternion = quaternion_joints(file, layout)
        self.quaternions = QuaternionJoints(layout, blocks, groups, is_quaternion, joints, Angles.of(file, layout))
        index_of = np.full(len(file.need(Definition).joints), -1)
        index_of[joints] = np.arange(len(joints))
        self.joints = len(joints)
        blocks = [_linear_part(block, is_quaternion, index_of) for block in blocks]
        blocks = [block for block in _without_overwritten(blocks) if block.values.size]
        attributes = np.full(
            ATTRIBUTES * len(joints), sum(len(block.outputs) for block in blocks)
        )  # a zero row follows the others
        row = 0
        for number, block in enumerate(blocks):
            joint, attribute = np.divmod(block.outputs, ATTRIBUTES)
            attributes[ATTRIBUTES * index_of[joint] + attribute] = row + np.arange(len(block.outputs))
            row += len(block.outputs)
            self.keep(**{f"values{number}": block.values.copy()})
        self.widths = [len(block.inputs) for block in blocks]
        inputs = np.concatenate([block.inputs for block in blocks] or [np.zeros(0)]).astype(np.int64)
        self.keep(inputs=inputs, rows_of_attributes=attributes)

    def forward(self, controls: Tensor) -> JointChanges:
        """All controls `(batch, control)` to changes of joints."""
        parts = controls.T.index_select(0, self.inputs).split(self.widths)
        rows = [self.get_buffer(f"values{number}").to(controls) @ part for number, part in enumerate(parts)]
        padded = torch.cat([*rows, controls.new_zeros(1, len(controls))])
        attributes = padded.index_select(0, self.rows_of_attributes).unflatten(0, (self.joints, ATTRIBUTES))
        return JointChanges(attributes, self.quaternions(controls), self.quaternions.positions)


def quaternion_joints(file: DnaFile, layout: Layout) -> np.ndarray:
    """Whether each joint's rotation is a quaternion, `(joint,)`."""
    count, representations = len(file.need(Definition).joints), file.find(JointRepresentations)
    result = np.zeros(count, bool)
    if representations is not None and len(representations.joints):
        if len(representations.joints) != count:
            raise layout.wrong(f"{len(representations.joints)} joints have representations, there are {count} joints")
        result[:] = [joint.rotation == QUATERNION for joint in representations.joints]
    return result


def group_block(file: DnaFile, layout: Layout, number: int, lod: int) -> Block:
    """The rows of a group that a level of detail uses.

    Raises:
        InputError: it is damaged.
    """
    group: JointGroup = file.need(Behavior).joints.groups[number]
    what = f"joint group {number}"
    rows, columns = len(group.outputs), len(group.inputs)
    if len(group.values) != rows * columns:
        raise layout.wrong(f"{what} has {len(group.values)} values, expected {rows} rows x {columns} columns")
    layout.check_controls(f"a column of {what}", group.inputs)
    layout.check(f"a row of {what}", group.outputs, ATTRIBUTES * len(file.need(Definition).joints), "joint attributes")
    layout.check_finite(what, group.values)
    used = layout.of_lod(what, group.row_counts, lod, rows)
    values = group.values.reshape(rows, columns)[:used]
    return Block(group.inputs.astype(np.int64), group.outputs[:used].astype(np.int64), values)


def used_columns(block: Block) -> np.ndarray:
    """The controls with a value other than 0 in a block."""
    return block.inputs[(block.values != 0).any(axis=0)]


def _linear_part(block: Block, is_quaternion: np.ndarray, index_of: np.ndarray) -> Block:
    """Rows of a block for evaluated joints without quaternions, and the columns that are non-zero in them."""
    joint = block.outputs // ATTRIBUTES
    rows = (index_of[joint] >= 0) & ~(is_quaternion[joint] & np.isin(block.outputs % ATTRIBUTES, ROTATION))
    values = block.values[rows]
    columns = (values != 0).any(axis=0)
    return Block(block.inputs[columns], block.outputs[rows], values[:, columns])


def _without_overwritten(blocks: list[Block]) -> list[Block]:
    """Blocks without rows whose attribute a later row overwrites."""
    seen: set[int] = set()
    result = []
    for block in reversed(blocks):
        kept = []
        for row in reversed(range(len(block.outputs))):
            if int(block.outputs[row]) not in seen:
                seen.add(int(block.outputs[row]))
                kept.append(row)
        rows = np.array(kept[::-1], dtype=np.int64)
        result.append(Block(block.inputs, block.outputs[rows], block.values[rows]))
    return result[::-1]
