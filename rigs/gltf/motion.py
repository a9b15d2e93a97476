"""From joint controls to coefficients: changes of the joint matrices, alone and times morph weights."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from riginv.geometry.euler import axis_rotations
from riginv.geometry.kinematics import compose, forward_kinematics, invert, transform_from, tree_levels, with_last_row
from riginv.geometry.skinning import NUMBERS
from riginv.rig.jacobian import Jacobian
from riginv.rig.joint_features import JointFreedom
from riginv.rig.subtree_jacobian import Generators, SubtreeJacobian, SubtreeSums, about, rotation_generators
from rigs.gltf.frames import LINEAR, Frames
from rigs.gltf.joint_controls import Drives

AXES = 3  # of space


class LocalMotion(NamedTuple):
    """The motion of frames in their own coordinates.

    Attributes:
        rotations: about the first, middle and last axis of each frame, three of `(batch, frame, 3, 3)`.
        scales: `(batch, frame, 3)`, applied before the rotations.
        translations: `(batch, frame, 3)`, mm along the axes of the frame.
    """

    rotations: tuple[Tensor, ...]
    scales: Tensor
    translations: Tensor

    @property
    def rotation(self) -> Tensor:
        first, middle, last = self.rotations
        return first @ middle @ last


class JointMotion(nn.Module):
    """Forward kinematics of frames.

    A frame moves its vertices by a 3x4 matrix M about its rest position c: x - c goes to M (x - c), and the change of the
    translation is the displacement of c. All coefficients are 0 at rest, and each moves vertices along one axis only: weights
    of targets are repeated three times, so that a mesh space can be computed axis by axis.

    Args:
        frames: as from `joint_frames`.
        drives: as from `joint_drives`.
        pairs: `(pair, 2)`, as from `frame_basis`.
    """

    rest: Tensor
    inverse_rest: Tensor
    pairs: Tensor
    orders: Tensor
    moved: Tensor
    scaled: Tensor
    scaled_axes: Tensor
    move_axes: Tensor

    def __init__(self, frames: Frames, drives: Drives, pairs: Tensor) -> None:
        super().__init__()
        self.parents, self.count = frames.parents, len(frames.names)
        move_axes = torch.linalg.solve(frames.rest[..., :3], frames.parent_axes)[drives.moved]
        buffers = {"rest": frames.rest.float(), "inverse_rest": invert(frames.rest).float(), "pairs": pairs}
        buffers |= {"orders": drives.orders, "moved": drives.moved, "scaled": drives.scaled}
        buffers |= {"scaled_axes": drives.scaled_axes.float(), "move_axes": move_axes.float()}
        for name, tensor in buffers.items():
            self.register_buffer(name, tensor, persistent=False)
        self.tree = SubtreeSums(frames.parents, tree_levels(frames.parents, frames.names))

    def forward(self, weights: Tensor, joints: Tensor) -> Tensor:
        """Weights `(batch, target)` and controls of joints `(batch, joint control)` to coefficients.

        These are `(batch, 3 target + 12 frame + 9 pair)`.
        """
        world = self.worlds(self.local(joints))
        return self._coefficients(weights, world)

    def local(self, joints: Tensor) -> LocalMotion:
        """Controls of joints `(batch, joint control)` to the motion of each frame."""
        angles, moves, sizes = joints.split([3 * self.count, 3 * len(self.moved), len(self.scaled)], dim=1)
        rotations = axis_rotations(torch.deg2rad(angles).unflatten(1, (-1, 3)), self.orders)
        translations = joints.new_zeros(joints.shape[0], self.count, 3)
        shifts = (self.move_axes.to(joints) @ moves.unflatten(1, (-1, 3))[..., None])[..., 0]
        scales = torch.ones_like(translations)
        scales = scales.index_add(1, self.scaled, (sizes - 1)[..., None] * self.scaled_axes.to(joints))
        return LocalMotion(rotations, scales, translations.index_copy(1, self.moved, shifts))

    def worlds(self, local: LocalMotion) -> Tensor:
        """World motions `(batch, frame, 3, 4)`, which are the identity at rest."""
        matrices = transform_from(local.rotation * local.scales[..., None, :], local.translations)
        rest, inverse_rest = self.rest.to(matrices), self.inverse_rest.to(matrices)
        return forward_kinematics(compose(compose(rest, matrices), inverse_rest), self.parents)

    @property
    def freedom(self) -> JointFreedom:
        moves, scales = (self.moved, self.move_axes), (self.scaled, self.scaled_axes)
        return JointFreedom(self.parents, self.rest, self.orders, *moves, *scales)

    @torch.no_grad()
    def with_jacobian(self, weights: Tensor, joints: Tensor) -> tuple[Tensor, Jacobian]:
        """As `forward`, with the Jacobian by all controls, morph weights first."""
        local = self.local(joints)
        world = self.worlds(local)
        about_centre = torch.cat([world[..., :3], world[..., :3] @ self.rest[..., 3:].to(world) + world[..., 3:]], dim=-1)
        matrices, generators = with_last_row(about_centre), self._generators(local, world)
        jacobian = SubtreeJacobian(tree=self.tree, matrices=matrices, generators=generators)
        found = self._coefficients(weights, world)
        return found, jacobian if not weights.shape[1] else Jacobian(inner=self._with_morphs(weights, world, jacobian.dense()))

    def _coefficients(self, weights: Tensor, world: Tensor) -> Tensor:
        centres = self.rest[..., 3:].to(world)
        linear = world[..., :3] - torch.eye(3, dtype=world.dtype, device=world.device)
        matrices = torch.cat([linear, linear @ centres + world[..., 3:]], dim=-1).flatten(2)
        products = linear.flatten(2)[:, self.pairs[:, 0]] * weights[:, self.pairs[:, 1], None]
        return torch.cat([weights.repeat_interleave(AXES, dim=1), matrices.flatten(1), products.flatten(1)], dim=1)

    def _with_morphs(self, weights: Tensor, world: Tensor, by_joints: Tensor) -> Tensor:
        """The dense Jacobian `(batch, coefficient, control)` of a rig with morph targets."""
        batch, targets = weights.shape
        linear = (world[..., :3] - torch.eye(3, dtype=world.dtype, device=world.device)).flatten(2)
        frames, of_pair = self.pairs[:, 0], self.pairs[:, 1]
        turned = by_joints.unflatten(1, (self.count, 3, 4))[:, :, :, :3].flatten(2, 3)  # (batch, frame, 9, joint control)
        products = (turned[:, frames] * weights[:, of_pair, None, None]).flatten(1, 2)
        of_weights = linear[:, frames, :, None] * torch.eye(targets).to(world)[of_pair][:, None]
        weights_alone = torch.eye(targets).to(world).repeat_interleave(AXES, dim=0).expand(batch, -1, -1)
        left = torch.cat(
            [weights_alone, world.new_zeros(batch, NUMBERS * self.count, targets), of_weights.flatten(1, 2)], dim=1
        )
        right = torch.cat([world.new_zeros(batch, AXES * targets, by_joints.shape[2]), by_joints, products], dim=1)
        return torch.cat([left, right], dim=2)

    def _generators(self, local: LocalMotion, world: Tensor) -> tuple[Generators, ...]:
        rest = self.rest.to(world)
        parents = torch.tensor(self.parents, device=world.device)
        above = torch.where((parents >= 0)[:, None, None], world[:, parents.clamp_min(0)], torch.eye(4)[:3].to(world))
        axes = above[..., :3] @ rest[..., :3]
        origin = compose(above, rest)[..., 3] + (axes @ local.translations[..., None])[..., 0]
        turns = torch.deg2rad(rotation_generators(axes, local.rotations, self.orders, origin))
        found = [Generators(torch.arange(self.count, device=world.device), turns)]
        if len(self.moved):
            ways = (axes[:, self.moved] @ self.move_axes.to(world)).mT[..., None]
            found.append(Generators(self.moved, torch.cat([ways.new_zeros(*ways.shape[:3], 3, 3), ways], dim=4)))
        if len(self.scaled):
            whole = local.rotation[:, self.scaled]
            growth = self.scaled_axes.to(world) / local.scales[:, self.scaled]
            stretch = axes[:, self.scaled] @ ((whole * growth[:, :, None]) @ whole.mT) @ torch.linalg.inv(axes[:, self.scaled])
            found.append(Generators(self.scaled, about(stretch, origin[:, self.scaled])[:, :, None]))
        return tuple(found)


def coefficient_names(frames: Frames, pairs: Tensor, targets: list[str]) -> list[str]:
    """Names of the coefficients of `JointMotion`: joint, row and column, and the target, if any."""
    full = [f"{row}{column}" for row in range(3) for column in range(NUMBERS // 3)]
    linear = [f"{row}{column}" for row in range(3) for column in range(LINEAR // 3)]
    morphs = [f"{name}.{axis}" for name in targets for axis in "xyz"]
    joints = [f"{name}.{entry}" for name in frames.names for entry in full]
    both = [f"{frames.names[frame]}.{entry} {targets[target]}" for frame, target in pairs.tolist() for entry in linear]
    return morphs + joints + both
