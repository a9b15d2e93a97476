"""The logic of the body rig: from controls to the skinning matrices of its joints."""

import roma
import torch
from torch import Tensor

from riginv.geometry.blendshapes import apply_deltas
from riginv.geometry.euler import axis_rotations
from riginv.geometry.kinematics import Skeleton, forward_kinematics, transform_from, tree_levels, with_last_row
from riginv.geometry.skinning import check_weights, skinning_basis
from riginv.rig.interface import LinearRig, Motion, Vjp
from riginv.rig.jacobian import Jacobian
from riginv.rig.joint_features import JointFeatures, JointFreedom, SkinFeatures
from riginv.rig.subtree_jacobian import Generators, SubtreeJacobian, SubtreeSums, rotation_generators
from rigs.body.build import FPS, body_geometry, walk
from rigs.body.controls import MOVES, build_controls
from rigs.body.looks import EXPRESSIONS
from rigs.body.skeleton import KEPT, LAST
from rigs.body.steps import BodySteps

ORDER = "XZY"  # of the rotations in a joint's frame: last axis first, then the middle one, then the first (skeleton.py)
AXES = torch.tensor([0, 2, 1])  # of a frame (skeleton.py): first, middle, last
METRE = 1000.0  # mm
NOISE_TWIST, NOISE_BEND = 12.0, 4.0  # degrees: standard deviation of joint noise about and across the bone
ROOT_FEATURES = 12  # position and rotation matrix of the root, first among the features


class BodyRig(LinearRig):
    """A body of 13,380 vertices with linear blend skinning (LBS) and 77 joints, controlled by joint angles; differentiable.

    The coefficients are, for each joint with skin weights, the 12 entries of its skinning matrix about its rest position.

    Attributes:
        joint_names: names of all joints, as in MakeHuman.
        parents: index of each joint's parent, -1 for the root.
    """

    angles: Tensor
    frames: Tensor
    offsets: Tensor
    skinned: Tensor
    parent_rows: Tensor
    feature_order: Tensor
    at_rest: Tensor
    driven: Tensor
    mix: Tensor

    def __init__(self) -> None:
        geometry = body_geometry()
        controls, drives = build_controls()
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
        for drive in drives:
            angles[control[drive.control], 3 * joint[drive.joint] + drive.axis] += drive.factor
        heads, parents = geometry["heads"], geometry["parents"]
        offsets = torch.where(parents[:, None] >= 0, heads - heads[parents], heads)
        buffers = {
            "angles": torch.deg2rad(angles),
            "frames": geometry["frames"],
            "offsets": offsets,
            "skinned": skinned,
            "parent_rows": parents,
        }
        for name, tensor in buffers.items():
            self.register_buffer(name, tensor.to(self.dtype) if tensor.is_floating_point() else tensor, persistent=False)
        self.moves = slice(control[MOVES[0]], control[MOVES[-1]] + 1)
        # The root has no skin: its rotation is that of the left side of the pelvis, which has no controls of its own.
        weight, pelvis = weights.sum(dim=0), joint["pelvis.L"]
        weight[pelvis] = weights.sum()
        rest = transform_from(geometry["frames"].to(self.dtype), heads)
        moves, none = (torch.zeros(1, dtype=torch.long), rest[:1, :, :3].mT), torch.zeros(0, dtype=torch.long)
        freedom = JointFreedom(self.parents, rest, AXES.repeat(len(KEPT), 1), *moves, none, torch.zeros(0, 3))
        features = JointFeatures(freedom, weight, METRE)
        self.skin_features = SkinFeatures(features, skinned, 0, none.view(0, 2))
        row = {number: index for index, number in enumerate(features.joints.tolist())}
        rows = torch.tensor([row[joint["root"] if number == pelvis else number] for number in skinned.tolist()])
        angles = features.angles.start + (3 * rows[:, None] + AXES).flatten()
        order = torch.cat([torch.arange(features.moves.start, features.moves.stop), torch.arange(9), angles])
        self.register_buffer("feature_order", order, persistent=False)
        loose = torch.full((len(KEPT), 3), NOISE_BEND)
        loose[:, LAST] = NOISE_TWIST
        loose[joint["root"]] = 0.0
        self.joint_noise = torch.deg2rad(loose).flatten().to(self.dtype)
        self.register_buffer("at_rest", self.neutral_coefficients(), persistent=False)
        self.tree = SubtreeSums(self.parents, tree_levels(self.parents, self.joint_names), skinned)
        by_axis = self.angles.unflatten(1, (-1, 3))[:, :, AXES].flatten(1)
        driven = by_axis.any(dim=0).nonzero()[:, 0]
        self.register_buffer("driven", driven, persistent=False)
        self.register_buffer("mix", torch.cat([by_axis[:, driven].T, torch.eye(len(controls))[self.moves]]), persistent=False)

    def expressions(self) -> dict[str, dict[str, float]]:
        return EXPRESSIONS

    def skeleton(self) -> Skeleton:
        geometry = body_geometry()
        heads, tails, weights = geometry["heads"], geometry["tails"], geometry["weights"]
        return Skeleton(self.joint_names, self.parents, heads, tails, weights, self.joint_transforms)

    @torch.no_grad()
    def motion(self) -> Motion:
        """A walk of 101 frames (`rigs.body.build.walk`)."""
        rotations, move = (values.to(self.rest_vertices) for values in walk())
        change = self.coefficients_of(rotations, move) - self.neutral_coefficients()
        return Motion("walk", FPS, apply_deltas(self.rest_vertices, self.basis, change))

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to the 12 entries of each skinned joint's matrix, `(batch, 12 * joint)`."""
        return self._coefficients(controls @ self.angles.to(controls), controls)

    def coefficients_with_joint_noise(self, controls: Tensor, parts: Tensor) -> Tensor:
        """As `coefficients`, with angles `parts` `(batch, 3 * joint)`, radians, added to those of the controls."""
        return self._coefficients(controls @ self.angles.to(controls) + parts, controls)

    @torch.no_grad()
    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        """As `coefficients`, with the Jacobian of kinematics and skinning, angles mixed by the controls."""
        frames, angles = self.frames.to(controls), (controls @ self.angles.to(controls)).unflatten(1, (-1, 3))
        orders = AXES.to(controls.device).expand(len(KEPT), -1)
        rotations = axis_rotations(angles[..., AXES], orders)
        worlds = self._worlds(frames @ rotations[0] @ rotations[1] @ rotations[2] @ frames.mT, controls[:, self.moves])
        above = worlds[:, self.parent_rows.clamp_min(0), :, :3]
        above = (
            torch.where((self.parent_rows < 0)[:, None, None], torch.eye(3, dtype=worlds.dtype, device=worlds.device), above)
            @ frames
        )
        turns = rotation_generators(above, rotations, orders, worlds[..., 3]).flatten(1, 2)[:, self.driven]
        moves = transform_from(worlds.new_zeros(3, 3, 3), torch.eye(3, dtype=worlds.dtype, device=worlds.device)).expand(
            len(worlds), 1, -1, -1, -1
        )
        generators = Generators(self.driven // 3, turns[:, :, None]), Generators(torch.zeros_like(self.driven[:1]), moves)
        jacobian = SubtreeJacobian(tree=self.tree, matrices=with_last_row(worlds), generators=generators, mix=self.mix)
        return worlds[:, self.skinned].flatten(1), jacobian

    def joint_transforms(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to the world transforms `(batch, joint, 3, 4)` of all joints, mm."""
        return self._worlds(self._rotations(controls @ self.angles.to(controls)), controls[:, self.moves])

    @torch.no_grad()
    def coefficients_and_vjp(self, controls: Tensor) -> tuple[Tensor, Vjp]:
        steps = BodySteps.of(self, controls @ self.angles.to(controls), controls)
        return super().coefficients_and_vjp(controls) if steps is None else (steps.coefficients, steps.vjp)

    def _coefficients(self, angles: Tensor, controls: Tensor) -> Tensor:
        if (steps := BodySteps.of(self, angles, controls)) is not None:
            return steps.coefficients
        return self.coefficients_of(self._rotations(angles), controls[:, self.moves])

    def _rotations(self, angles: Tensor) -> Tensor:
        """Angles `(batch, 3 * joint)`, radians, to the rotation of each joint relative to its parent."""
        frames = self.frames.to(angles)
        return frames @ roma.euler_to_rotmat(ORDER, angles.unflatten(1, (-1, 3)).unbind(-1)) @ frames.mT

    def features(self, coefficients: Tensor) -> Tensor:
        """Position of the root, metres, its rotation matrix, and the angles of each joint relative to its parent, radians."""
        return self.skin_features(coefficients - self.at_rest.to(coefficients))[:, self.feature_order]

    def feature_change(self, before: Tensor, after: Tensor) -> Tensor:
        change = after - before
        angles = torch.remainder(change[:, ROOT_FEATURES:] + torch.pi, 2 * torch.pi) - torch.pi
        return torch.cat([change[:, :ROOT_FEATURES], angles], dim=1)

    def coefficients_of(self, rotations: Tensor, move: Tensor) -> Tensor:
        """The coefficients of any pose of the skeleton, also outside the range of the controls.

        Args:
            rotations: of each joint relative to its parent, `(batch, joint, 3, 3)`; the identity at rest.
            move: displacement of the root, `(batch, 3)`, mm.
        """
        return self._worlds(rotations, move)[:, self.skinned].flatten(1)

    def _worlds(self, rotations: Tensor, move: Tensor) -> Tensor:
        """World transforms of all joints, `(batch, joint, 3, 4)`."""
        offsets = self.offsets.to(rotations).expand(rotations.shape[0], -1, -1)
        offsets = torch.cat([offsets[:, :1] + move[:, None], offsets[:, 1:]], dim=1)  # the root is the first joint
        return forward_kinematics(transform_from(rotations, offsets), self.parents)
