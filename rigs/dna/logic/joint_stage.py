"""Joint logic in the order of the reference: joint groups, twists and swings, nets."""

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format import DnaFile
from rigs.dna.format.later_layers import MachineLearningOperations, TwistsAndSwings
from rigs.dna.format.layers import Definition
from rigs.dna.logic.joints import JointChanges, JointGroups
from rigs.dna.logic.layout import Layout, Stage
from rigs.dna.logic.learned_joints import LearnedJoints
from rigs.dna.logic.rotations import Angles, matrix_angles, quaternion_matrices
from rigs.dna.logic.twists import TwistedJoints

ROTATION = slice(3, 6)  # of a joint's nine attributes


class JointStage(Stage):
    """From controls to changes of joints.

    Args:
        joints: indices of the joints to evaluate, `(joint,)`, in the order of the results.

    Raises:
        InputError: the file is damaged.
    """

    quaternion_joints: Tensor
    of_quaternions: Tensor
    of_twisted: Tensor
    of_learned: Tensor

    def __init__(self, file: DnaFile, layout: Layout, lod: int, joints: np.ndarray) -> None:
        super().__init__()
        count = len(file.need(Definition).joints)
        self.angles = Angles.of(file, layout)
        self.groups = JointGroups(file, layout, lod, joints)
        twists, operations = file.find(TwistsAndSwings), file.find(MachineLearningOperations)
        self.twisted = TwistedJoints(layout, twists, joints, count) if twists else None
        self.learned = None
        if operations is not None and len(operations.outputs):
            self.learned = LearnedJoints(layout, operations, self.angles, joints, count)
        parts = [part.positions for part in (self.groups.quaternions, self.twisted, self.learned) if part is not None]
        quaternion_joints = torch.cat(parts).unique()
        self.keep(quaternion_joints=quaternion_joints)
        for name, part in (("quaternions", self.groups.quaternions), ("twisted", self.twisted), ("learned", self.learned)):
            if part is not None:
                self.keep(**{f"of_{name}": torch.searchsorted(quaternion_joints, part.positions)})

    def forward(self, controls: Tensor) -> JointChanges:
        """All controls `(batch, control)` to changes of joints."""
        attributes, quaternions, _ = self.groups(controls)
        if not len(self.quaternion_joints):
            return JointChanges(attributes, quaternions, self.quaternion_joints)
        rotations = self.angles.quaternions(attributes[self.quaternion_joints, ROTATION].movedim(-1, 0))
        rotations = rotations.index_copy(1, self.of_quaternions, quaternions)
        if self.twisted is not None:
            rotations = rotations.index_copy(1, self.of_twisted, self.twisted(controls))
        if self.learned is not None:
            attributes, moved = self.learned(controls, attributes, rotations[:, self.of_learned])
            rotations = rotations.index_copy(1, self.of_learned, moved)
        return JointChanges(attributes, rotations, self.quaternion_joints)

    def rotations(self, angles: Tensor, changes: JointChanges) -> Tensor:
        """Rotation `(joint, 3, 3, batch)` of each joint relative to its neutral pose.

        Args:
            angles: the Euler angles among the changes, `(joint, 3, batch)`.
        """
        matrices = self.angles.matrices(angles, dim=1)
        if not len(changes.quaternion_joints):
            return matrices
        return matrices.index_copy(0, changes.quaternion_joints, quaternion_matrices(changes.quaternions).movedim(0, -1))

    def as_euler(self, changes: JointChanges) -> Tensor:
        """Translations, Euler angles and scales `(batch, joint, 9)`, in the file's units."""
        matrices = quaternion_matrices(changes.quaternions)
        angles = self.angles.in_file(matrix_angles(matrices, self.angles.sequence))
        result = changes.attributes.movedim(-1, 0).clone()
        result[:, changes.quaternion_joints, ROTATION] = angles
        return result

    def as_quaternions(self, changes: JointChanges) -> Tensor:
        """Translations, quaternions x y z w and scales `(batch, joint, 10)`."""
        attributes = changes.attributes.movedim(-1, 0)
        rotations = self.angles.quaternions(attributes[..., ROTATION])
        rotations = rotations.index_copy(1, changes.quaternion_joints, changes.quaternions)
        return torch.cat([attributes[..., :3], rotations, attributes[..., 6:]], dim=-1)
