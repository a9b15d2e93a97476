"""Rotations, translations and scales of joints relative to their parents: inputs of an inverse network."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from riginv.geometry.euler import LOCKED, euler_angles, nearest_angles
from riginv.geometry.kernels.library import Kernels, kernels_for
from riginv.geometry.kinematics import tree_levels
from riginv.geometry.skinning import NUMBERS

LEAST_DETERMINANT = 0.1  # of an estimated matrix: below, its inverse is not trusted
LEAST_SCALE = 0.1  # of an estimated matrix along an axis


class JointFreedom(NamedTuple):
    """The motion of joints relative to their parents.

    Attributes:
        parents: index of each joint's parent, -1 for a root.
        rest: `(joint, 3, 4)`: the coordinate system that each joint rotates in, in world space at rest, mm.
        orders: the axes of each joint's rotations, the outermost first, `(joint, 3)`.
        moved: joints that translate, `(moved,)`.
        move_axes: the axes of their translations as columns, in their coordinate systems, `(moved, 3, 3)`.
        scaled: joint of each scale, `(scale,)`.
        scaled_axes: the axes that it scales, 1 or 0, `(scale, 3)`.
    """

    parents: Sequence[int]
    rest: Tensor
    orders: Tensor
    moved: Tensor
    move_axes: Tensor
    scaled: Tensor
    scaled_axes: Tensor


class JointFeatures(nn.Module):
    """Maps the matrices of joints to features, and these back to angles, translations and scales.

    The matrices may be estimates, neither orthogonal nor free of noise. A joint with hardly any vertices has no estimate and no
    features: the joints below it are taken relative to the nearest one above it that has some. For a root without vertices
    stands the joint below it with the most vertices, as if it were at rest.

    The features are, in this order: the rotation matrix of each root, the angles of each joint, radians, the translations of
    joints in multiples of `length_mm`, and their scales minus 1.

    Args:
        freedom: of all joints.
        weight: `(joint,)`: the sum of each joint's skin weights; 0: it has hardly any vertices.
        length_mm: the length that counts as 1.
    """

    joints: Tensor
    source: Tensor
    parents: Tensor
    roots: Tensor
    rest: Tensor
    shift: Tensor
    inverse_rest: Tensor
    orders: Tensor
    moved: Tensor
    to_moves: Tensor
    scaled: Tensor
    scaled_axes: Tensor
    of_moved: Tensor
    of_scaled: Tensor

    def __init__(self, freedom: JointFreedom, weight: Float[Tensor, " joint"], length_mm: float) -> None:
        super().__init__()
        source, above = visible_joints(freedom.parents, weight)
        joints = (source >= 0).nonzero()[:, 0]
        row = torch.full((len(source),), -1).index_put((joints,), torch.arange(len(joints)))
        inverse_rest = torch.linalg.inv(freedom.rest[..., :3].double())
        of_moved = (source[freedom.moved] >= 0).nonzero()[:, 0]
        of_scaled = (source[freedom.scaled] >= 0).nonzero()[:, 0]
        moved, axes = freedom.moved[of_moved], freedom.move_axes[of_moved].double()
        parents = torch.where(above[joints] >= 0, row[above[joints]], -1)
        buffers = {
            "joints": joints,
            "source": source[joints],
            "parents": parents,
            "roots": (parents < 0).nonzero()[:, 0],
            "rest": freedom.rest[joints],
            "shift": freedom.rest[joints, :, 3] - freedom.rest[source[joints], :, 3],
            "inverse_rest": inverse_rest[joints].to(freedom.rest),
            "orders": freedom.orders[joints],
            "moved": row[moved],
            "to_moves": (torch.linalg.inv(axes) @ inverse_rest[moved] / length_mm).to(freedom.rest),
            "scaled": row[freedom.scaled[of_scaled]],
            "scaled_axes": freedom.scaled_axes[of_scaled] / freedom.scaled_axes[of_scaled].sum(dim=1, keepdim=True),
            "of_moved": of_moved,
            "of_scaled": of_scaled,
        }
        for name, tensor in buffers.items():
            self.register_buffer(name, tensor, persistent=False)
        self.length_mm, self.count = length_mm, len(source)
        first, last = 9 * len(self.roots), 9 * len(self.roots) + 3 * len(joints)
        self.angles, self.moves = slice(first, last), slice(last, last + 3 * len(moved))
        self.counts = 3 * len(source), 3 * len(freedom.moved), len(freedom.scaled)

    def forward(self, matrices: Float[Tensor, "batch joint 3 4"]) -> Float[Tensor, "batch feature"]:
        """Features `(batch, feature)`.

        Args:
            matrices: of all joints, the change of each from rest: its rotation and scale minus the identity, and the
                displacement of its rest position, mm.
        """
        compiled = None if torch.is_grad_enabled() and matrices.requires_grad else kernels_for(matrices)
        found = self._relative(matrices) if compiled is None else self._relative_compiled(compiled, matrices)
        angles, moves, scales = found
        linear = matrices[:, self.source[self.roots], :, :3] + torch.eye(3, dtype=matrices.dtype, device=matrices.device)
        moves = self.to_moves.to(matrices) @ moves[:, self.moved, :, None]
        sizes = ((scales[:, self.scaled] - 1) * self.scaled_axes.to(matrices)).sum(dim=2)
        return torch.cat([linear.flatten(1), angles.flatten(1), moves.flatten(1), sizes], dim=1)

    def _relative(self, matrices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Angles, displacements and scales of each joint relative to the one above it, each `(batch, joint, 3)`."""
        change = matrices[:, self.source]
        rest, eye = self.rest.to(change), torch.eye(3, dtype=change.dtype, device=change.device)
        linear = change[..., :3] + eye
        position = rest[..., 3] + change[..., 3] + (change[..., :3] @ self.shift.to(change)[..., None])[..., 0]
        is_root, above = (self.parents < 0)[:, None], self.parents.clamp_min(0)
        inverse = inverse_3x3(torch.where(is_root[..., None], eye, linear[:, above]))
        local = (self.inverse_rest.to(change) @ inverse) @ (linear @ rest[..., :3])
        scales = local.square().sum(dim=2).sqrt()
        rotations = local / scales.clamp_min(LEAST_SCALE)[..., None, :]
        parent, parent_rest = (torch.where(is_root, 0.0, places[..., above, :]) for places in (position, rest[..., 3]))
        moves = (inverse @ (position - parent)[..., None])[..., 0] - (rest[..., 3] - parent_rest)
        return euler_angles(rotations, self.orders), moves, scales

    def _relative_compiled(self, compiled: Kernels, matrices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """As `_relative`, by a kernel."""
        matrices, count = matrices.detach().contiguous(), len(self.source)
        angles, moves, scales = (matrices.new_empty(len(matrices), count, 3) for _ in range(3))
        least = matrices.new_tensor([LEAST_DETERMINANT, LEAST_SCALE, LOCKED])
        rest, inverse_rest, shift = (values.to(matrices).contiguous() for values in (self.rest, self.inverse_rest, self.shift))
        of_joints = self.source, self.parents, rest, inverse_rest, shift, self.orders.contiguous()
        given = matrices, matrices.shape[1], *of_joints
        compiled.call("joint_features", matrices.dtype, *given, count, least, angles, moves, scales, len(matrices))
        return angles, moves, scales

    def change(
        self, before: Float[Tensor, "#batch feature"], after: Float[Tensor, "batch feature"]
    ) -> Float[Tensor, "batch feature"]:
        """The difference of features `(batch, feature)`, angles the shorter way round."""
        change = after - before
        angles = torch.remainder(change[:, self.angles] + torch.pi, 2 * torch.pi) - torch.pi
        return torch.cat([change[:, : self.angles.start], angles, change[:, self.angles.stop :]], dim=1)

    def controls(
        self,
        features: Float[Tensor, "batch feature"],
        lower: Float[Tensor, "joint 3"],
        upper: Float[Tensor, "joint 3"],
    ) -> Float[Tensor, "batch control"]:
        """Angles of all joints, degrees, translations, mm, and scales, from features: `(batch, 3 joint + 3 moved + scale)`.

        Those of joints without features are 0, scales 1. Of the angles that make a rotation the ones within limits are taken.

        Args:
            lower, upper: limits of the angles, radians.
        """
        limits = lower[self.joints], upper[self.joints]
        found = features[:, self.angles].unflatten(1, (-1, 3))
        angles = torch.rad2deg(nearest_angles(found, torch.zeros_like(found), self.orders, *limits))
        moves, sizes = self.length_mm * features[:, self.moves].unflatten(1, (-1, 3)), 1 + features[:, self.moves.stop :]
        parts = ((angles, self.joints, 0.0), (moves, self.of_moved, 0.0), (sizes, self.of_scaled, 1.0))
        return torch.cat([_spread(*part, count) for part, count in zip(parts, self.counts)], dim=1)


class SkinFeatures(nn.Module):
    """Features of a skinned rig with morph targets: the weights of these, then those of the joints.

    The coefficients of the rig are, in this order, the weight of each target along the three axes, the matrices of joints, and
    the product of each pair's matrix, less the identity, with the weight of its target.

    Args:
        joints: of all joints.
        given: indices of those with matrices, `(matrix,)`; the others never move.
        targets: number of targets.
        pairs: indices of a matrix and of a target, `(pair, 2)`.
    """

    given: Tensor
    pairs: Tensor
    shares: Tensor
    alone: Tensor

    def __init__(
        self, joints: JointFeatures, given: Int[Tensor, " matrix"], targets: int, pairs: Int[Tensor, "pair 2"]
    ) -> None:
        super().__init__()
        self.joints, self.targets = joints, targets
        self.sizes = 3 * targets, NUMBERS * len(given), 9 * len(pairs)
        times = torch.bincount(pairs[:, 1], minlength=targets)
        for name, tensor in {"given": given, "pairs": pairs, "shares": 1 / times.clamp_min(1), "alone": times == 0}.items():
            self.register_buffer(name, tensor, persistent=False)

    def forward(self, coefficients: Float[Tensor, "batch coefficient"]) -> Float[Tensor, "batch feature"]:
        along, matrices, products = coefficients.split(self.sizes, dim=1)
        matrices = matrices.unflatten(1, (-1, 3, 4))
        everyone = matrices.new_zeros(1, self.joints.count, 3, 4).expand(matrices.shape[0], -1, -1, -1)
        found = self.joints(everyone.index_copy(1, self.given, matrices))
        if not self.targets:
            return found
        along = along.unflatten(1, (-1, 3))
        turned = torch.diag_embed(along)[:, self.pairs[:, 1]] + products.unflatten(1, (-1, 3, 3))
        rotations = (matrices[..., :3] + torch.eye(3, dtype=along.dtype, device=along.device))[:, self.pairs[:, 0]]
        of_pairs = (rotations * turned).sum(dim=(2, 3)) / rotations.square().sum(dim=(2, 3))
        weights = torch.where(self.alone, along.mean(dim=2), 0.0)
        weights = weights.index_add(1, self.pairs[:, 1], of_pairs * self.shares.to(along)[self.pairs[:, 1]])
        return torch.cat([weights, found], dim=1)

    def change(
        self, before: Float[Tensor, "#batch feature"], after: Float[Tensor, "batch feature"]
    ) -> Float[Tensor, "batch feature"]:
        """The difference of features `(batch, feature)`, angles the shorter way round."""
        weights = (after - before)[:, : self.targets]
        return torch.cat([weights, self.joints.change(before[:, self.targets :], after[:, self.targets :])], dim=1)


def _spread(values: Tensor, indices: Tensor, filling: float, count: int) -> Tensor:
    """Values `(batch, row, ...)` at `indices` `(row,)` among `count` values, flattened."""
    rows = count // max(values.shape[2:].numel(), 1)
    everywhere = values.new_full((1, rows, *values.shape[2:]), filling).expand(values.shape[0], *(-1 for _ in values.shape[1:]))
    return everywhere.index_copy(1, indices, values).flatten(1)


def inverse_3x3(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Inverses of matrices near rotations, which are not known to be regular."""
    first, second, third = matrices.unbind(-1)
    rows = [torch.linalg.cross(second, third), torch.linalg.cross(third, first), torch.linalg.cross(first, second)]
    determinant = (first * rows[0]).sum(dim=-1)
    return torch.stack(rows, dim=-2) / determinant.clamp_min(LEAST_DETERMINANT)[..., None, None]


def visible_joints(
    parents: Sequence[int], weight: Float[Tensor, " joint"]
) -> tuple[Int[Tensor, " joint"], Int[Tensor, " joint"]]:
    """For each joint the one whose matrix it has, -1: none; and the nearest joint above it that has one, -1: none."""
    levels, nobody = tree_levels(parents), torch.full((len(parents),), -1)
    source, above, root = torch.where(weight > 0, torch.arange(len(parents)), nobody), nobody.clone(), list(range(len(parents)))
    heaviest: dict[int, int] = {}
    for joint in torch.cat(levels).tolist():
        root[joint] = joint if parents[joint] < 0 else root[parents[joint]]
        before = heaviest.setdefault(root[joint], joint)
        heaviest[root[joint]] = joint if weight[joint] > weight[before] else before
    for joint, other in heaviest.items():
        source[joint] = source[joint] if source[joint] >= 0 else source[other]
    for joint in torch.cat(levels[1:]).tolist() if len(levels) > 1 else []:
        above[joint] = parents[joint] if source[parents[joint]] >= 0 else above[parents[joint]]
    return source, above
