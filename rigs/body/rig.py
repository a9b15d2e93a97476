"""The body rig's logic: from controls to the skinning matrices of its joints."""

import roma
import torch
from torch import Tensor

from riginv.geometry.kinematics import forward_kinematics, transform_from, tree_levels
from riginv.geometry.skinning import check_weights, skinning_basis
from riginv.rig import LinearRig
from rigs.body.build import body_geometry
from rigs.body.controls import MOVES, build_controls
from rigs.body.looks import EXPRESSIONS
from rigs.body.skeleton import KEPT

ORDER = "XZY"  # of a joint's turns in its frame: about its last axis first, then the middle one, then the first (axes.py)


class BodyRig(LinearRig):
    """A body of 13,380 vertices, skinned linearly to 77 joints, moved by joint angles; differentiable throughout.

    The coefficients are, joint by joint, the 12 numbers of its skinning matrix about its place at rest: where it has turned,
    and where it has gone. Joints that carry no skin have none.

    Attributes:
        joint_names: all joints, in MakeHuman's names.
        parents: the number of each joint's parent, -1 for the root.
    """

    def __init__(self) -> None:
        geometry = body_geometry()
        controls, turns = build_controls()
        self.joint_names, self.parents = KEPT, tuple(geometry["parents"].tolist())
        weights = geometry["weights"]
        check_weights(weights, "the body's weights", self.joint_names)
        skinned = (weights > 0).any(dim=0).nonzero()[:, 0]
        basis = skinning_basis(geometry["rest_vertices"], weights[:, skinned], geometry["heads"][skinned])
        names = [f"{KEPT[joint]}[{row}][{column}]" for joint in skinned.tolist() for row in range(3) for column in range(4)]
        super().__init__("body", controls, geometry["rest_vertices"], geometry["faces"], basis, names)

        control = {name: number for number, name in enumerate(self.control_names)}
        joint = {name: number for number, name in enumerate(self.joint_names)}
        angles = torch.zeros(len(controls), 3 * len(KEPT), dtype=torch.float64)
        for turn in turns:
            angles[control[turn.control], 3 * joint[turn.joint] + turn.axis] += turn.share
        heads, parents = geometry["heads"], geometry["parents"]
        offsets = torch.where(parents[:, None] >= 0, heads - heads[parents], heads)
        buffers = {"angles": torch.deg2rad(angles), "frames": geometry["frames"], "offsets": offsets, "skinned": skinned}
        for name, tensor in buffers.items():
            self.register_buffer(name, tensor.to(self.dtype) if tensor.is_floating_point() else tensor, persistent=False)
        self.moves = slice(control[MOVES[0]], control[MOVES[-1]] + 1)
        self.levels = tree_levels(self.parents, self.joint_names)

    def expressions(self) -> dict[str, dict[str, float]]:
        return EXPRESSIONS

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to the 12 numbers of each skinned joint's matrix, `(batch, 12 * joint)`."""
        angles = (controls @ self.angles.to(controls)).unflatten(1, (-1, 3))
        frames = self.frames.to(controls)
        rotations = frames @ roma.euler_to_rotmat(ORDER, angles) @ frames.mT
        return self.coefficients_of(rotations, controls[:, self.moves])

    def coefficients_of(self, rotations: Tensor, move: Tensor) -> Tensor:
        """The coefficients of any pose of the skeleton, in reach of the controls or not.

        Args:
            rotations: of each joint against its parent, `(batch, joint, 3, 3)`; the identity at rest.
            move: of the root, `(batch, 3)`, mm.
        """
        offsets = self.offsets.to(rotations).expand(len(rotations), -1, -1)
        offsets = torch.cat([offsets[:, :1] + move[:, None], offsets[:, 1:]], dim=1)  # the root is the first joint
        worlds = forward_kinematics(transform_from(rotations, offsets), self.parents, self.levels)
        return worlds[:, self.skinned].flatten(1)
