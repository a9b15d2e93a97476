"""Joints moved by nets, in addition to the joint groups."""

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format.later_layers import MachineLearningOperations
from rigs.dna.logic.layout import Layout, Stage
from rigs.dna.logic.rotations import Angles, multiply, normalise

ROTATION_TYPE, QUATERNION = 1, 1
BASIS = range(3, 10)  # keys of a change of basis


class LearnedJoints(Stage):
    """Adds translations and scales, and applies rotations, from values of controls.

    Written from notes on the format, without a file to test against (docs/dna.md).

    Attributes:
        positions: indices of the moved joints among the evaluated ones, `(moved,)`.

    Raises:
        InputError: it is damaged, or has a basis of its own, which is not evaluated here.
    """

    positions: Tensor
    inputs: Tensor

    def __init__(
        self, layout: Layout, entry: MachineLearningOperations, angles: Angles, joints: np.ndarray, count: int
    ) -> None:
        super().__init__()
        what = "the block of joints that nets move"
        layout.check_lengths(what, keys=len(entry.keys), values=len(entry.values))
        layout.check_lengths(what, inputs=len(entry.inputs), outputs=len(entry.outputs))
        parameters = dict(zip(entry.keys.tolist(), entry.values.tolist()))
        if all(key in parameters for key in BASIS):
            raise layout.wrong(f"{what} has a basis of its own, which cannot be evaluated here")
        self.euler, self.angles = parameters.get(ROTATION_TYPE, 0) != QUATERNION, angles
        stride = 9 if self.euler else 10
        layout.check_controls(what, entry.inputs)
        layout.check(what, entry.outputs, stride * count, "joint attributes")
        index_of = {int(joint): number for number, joint in enumerate(joints)}
        moved = [joint for joint in np.unique(entry.outputs // stride).tolist() if joint in index_of]
        row_of = {joint: row for row, joint in enumerate(moved)}
        inputs = np.full((len(moved), stride), layout.total)
        for control, attribute in zip(entry.inputs.tolist(), entry.outputs.tolist()):
            if attribute // stride in row_of:
                inputs[row_of[attribute // stride], attribute % stride] = control
        self.keep(positions=np.array([index_of[joint] for joint in moved], dtype=np.int64), inputs=inputs)

    def forward(self, controls: Tensor, attributes: Tensor, quaternions: Tensor) -> tuple[Tensor, Tensor]:
        """The attributes `(joint, 9, batch)` and the quaternions `(batch, moved, 4)` of the moved joints, changed."""
        padded = torch.cat([controls, controls.new_zeros(len(controls), 1)], dim=1)
        found = padded.index_select(1, self.inputs.flatten()).unflatten(1, self.inputs.shape)
        rotations = self.angles.quaternions(found[..., 3:6]) if self.euler else normalise(found[..., 3:7])
        zeros = torch.zeros_like(found[..., :3])
        added = torch.cat([found[..., :3], zeros, found[..., -3:]], dim=-1)
        return attributes.index_add(0, self.positions, added.movedim(0, -1)), multiply(rotations, quaternions)
