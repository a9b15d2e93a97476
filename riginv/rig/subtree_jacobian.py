"""The Jacobian of linear blend skinning by joint controls, in products over the subtrees of the skeleton.

A motion of a joint moves everything below it as one piece: the derivative of the skinning matrix M of each of these joints is
X M, with one affine generator X for the motion. So J^T G J needs sums of 4x4 blocks over subtrees, and never the dense
Jacobian: for a hundred joints a hundredth of the work. A control is one motion, or a sum of motions of several joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from riginv.geometry.kernels.library import Kernels, kernels_for
from riginv.rig.jacobian import Jacobian

BATCH_SIZE = 16  # Gram matrices at a time: they fit a processor's cache
NEGLIGIBLE = 1e-5  # of the largest entry of a metric: differences between its three axes that are rounding


class Generators(NamedTuple):
    """Generators of the motions of some joints, equally many for each.

    Attributes:
        joints: `(owner,)`.
        values: `(batch, owner, motion of the owner, 3, 4)`, per unit of each motion.
    """

    joints: Tensor
    values: Tensor


def rotation_generators(
    above: Float[Tensor, "batch joint 3 3"],
    rotations: tuple[Tensor, ...],
    orders: Int[Tensor, "joint 3"],
    centres: Float[Tensor, "batch joint 3"],
) -> Float[Tensor, "batch joint 3 3 4"]:
    """Generators of the three angles of each joint, by axis, per radian.

    Args:
        above: from the axes of each joint to the world, without its own motion.
        rotations: about the first, middle and last axis of each joint (`axis_rotations`).
        orders: the axes of these rotations, the outermost first.
        centres: of the rotations, in the world.
    """
    first, middle, _ = rotations
    unit = torch.eye(3, dtype=above.dtype, device=above.device)[orders]  # (joint, position, 3)
    by_position = torch.stack(
        [
            unit[:, 0].expand(len(above), -1, -1),
            (first @ unit[:, 1, :, None])[..., 0],
            (first @ middle @ unit[:, 2, :, None])[..., 0],
        ],
        dim=2,
    )
    spins = torch.empty_like(by_position).scatter_(2, orders[None, :, :, None].expand(by_position.shape), by_position)
    cross = torch.linalg.cross(
        spins[..., None, :].expand(*spins.shape, 3),
        torch.eye(3, dtype=above.dtype, device=above.device).expand(*spins.shape, 3),
    ).mT
    return about(above[:, :, None] @ cross @ torch.linalg.inv(above)[:, :, None], centres[:, :, None])


def about(linear: Float[Tensor, "*batch 3 3"], centres: Float[Tensor, "*other 3"]) -> Float[Tensor, "*batch 3 4"]:
    """Affine generators from linear ones about points."""
    return torch.cat([linear, -linear @ centres[..., None]], dim=-1)


class SubtreeSums:
    """Sums over the subtrees of a skeleton, and the metric of skinning matrices in blocks.

    Args:
        parents: of each joint, -1 for a root.
        levels: `tree_levels` of the parents.
        skinned: the joints whose skinning matrices are coefficients; None: all.
    """

    def __init__(self, parents: Sequence[int], levels: Sequence[Tensor], skinned: Tensor | None = None) -> None:
        self.parents, self.levels = torch.tensor(parents), levels
        self.skinned = torch.arange(len(parents)) if skinned is None else skinned
        self.deepest_first = torch.cat(list(levels)).flip(0).contiguous()
        self.below = torch.eye(len(parents), dtype=torch.bool)  # (ancestor, joint)
        for level in levels[1:]:
            self.below[:, level] |= self.below[:, self.parents[level]]
        self._blocks: tuple[Tensor | None, Tensor | None] = None, None

    def add_up(self, values: Tensor) -> Tensor:
        """Add to the values `(batch, joint, ...)` of each joint those of all joints below it, in place."""
        for level in reversed(self.levels[1:]):
            level = level.to(values.device)
            values.index_add_(1, self.parents.to(values.device)[level], values.index_select(1, level))
        return values

    def blocks(self, metric: Tensor) -> Tensor | None:
        """A metric of 3x4 matrices as `(joint, 4, 4 joint)`, where it treats their three rows alike and apart; else None."""
        seen, blocks = self._blocks
        if seen is not metric:
            blocks = _blocks(metric, len(self.skinned))
            if blocks is not None and len(self.skinned) < (count := len(self.parents)):
                to = self.skinned.to(metric.device)
                wide = blocks.new_zeros(count, 4, count, 4)
                wide[to[:, None], :, to] = blocks.unflatten(2, (-1, 4)).transpose(1, 2)
                blocks = wide.flatten(2)
            self._blocks = metric, blocks
        return blocks


def _blocks(metric: Tensor, joints: int) -> Tensor | None:
    dense = metric.to_dense() if metric.is_sparse_csr else metric
    if len(dense) != 12 * joints:
        return None
    rows = dense.view(joints, 3, 4, joints, 3, 4).permute(1, 4, 0, 2, 3, 5).reshape(3, 3, joints, 4, 4 * joints)
    expected = rows[0, 0] * torch.eye(3, dtype=rows.dtype, device=rows.device)[:, :, None, None, None]
    return rows[0, 0].contiguous() if (rows - expected).abs().max() <= NEGLIGIBLE * rows.abs().max() else None


@dataclass(frozen=True, kw_only=True)
class SubtreeJacobian(Jacobian):
    """d skinning matrices / d controls of a batch, for the 12 entries of each joint's matrix, row by row.

    Attributes:
        tree: the skeleton.
        matrices: skinning matrices `(batch, joint, 4, 4)`, with the row 0 0 0 1.
        generators: of motions, which are the controls in their order where there is no `mix`.
        mix: of each control, `(motion, control)`: its motions.
        columns: indices of the controls that are kept; None: all.
        scale: of each kept control.
    """

    tree: SubtreeSums
    matrices: Tensor
    generators: tuple[Generators, ...]
    mix: Tensor | None = None
    columns: Tensor | None = None
    scale: Tensor | None = None

    def dense(self) -> Float[Tensor, "batch coefficient control"]:
        below, skinned = self.tree.below.to(self.matrices)[:, self.tree.skinned], self.matrices[:, self.tree.skinned]
        parts = []
        for joints, values in self.generators:
            moved = torch.einsum("bonrc,bjcd->bonjrd", values, skinned) * below[joints][None, :, None, :, None, None]
            parts.append(moved.flatten(1, 2).flatten(2))
        return self._chosen(torch.cat(parts, dim=1)).transpose(1, 2)

    def times(self, rows: Float[Tensor, "row coefficient"]) -> Float[Tensor, "row control"]:
        return self.times_each(rows[None])[0]

    def times_each(self, rows: Float[Tensor, "batch row coefficient"]) -> Float[Tensor, "batch row control"]:
        pulls = rows.new_zeros(*rows.shape[:2], len(self.tree.parents), 3, 4)
        pulls[:, :, self.tree.skinned] = rows.unflatten(2, (-1, 3, 4)) @ self.matrices[:, None, self.tree.skinned].mT
        pulls = self.tree.add_up(pulls.transpose(1, 2).contiguous()).flatten(3)  # (batch, joint, row, 12)
        parts = [(values.flatten(3) @ pulls[:, joints].mT).flatten(1, 2) for joints, values in self.generators]
        return self._chosen(torch.cat(parts, dim=1)).transpose(1, 2)

    def vjp(self, gradient: Float[Tensor, "batch coefficient"]) -> Float[Tensor, "batch control"]:
        return self.times_each(gradient[:, None])[:, 0]

    def of_controls(self, controls: Int[Tensor, " control"]) -> "SubtreeJacobian":
        columns = controls if self.columns is None else self.columns[controls]
        return replace(self, columns=columns, scale=None if self.scale is None else self.scale[controls])

    def scaled(self, scale: Float[Tensor, " control"]) -> "SubtreeJacobian":
        return replace(self, scale=scale if self.scale is None else self.scale * scale)

    def gram(self, metric: Tensor) -> Tensor:
        blocks = self.tree.blocks(metric)
        if blocks is None:
            return Jacobian(inner=self.dense()).gram(metric)
        compiled = kernels_for(blocks, self.matrices)
        if compiled is not None:
            return self._chosen(self._chosen(self._compiled(compiled, blocks)).transpose(1, 2))
        found = [self._gram(blocks, slice(first, first + BATCH_SIZE)) for first in range(0, len(self.matrices), BATCH_SIZE)]
        return self._chosen(self._chosen(torch.cat(found)).transpose(1, 2))

    def _compiled(self, compiled: Kernels, blocks: Tensor) -> Tensor:
        """The Gram matrices by a kernel."""
        values = torch.cat([values.flatten(1, 2) for _, values in self.generators], dim=1).contiguous()
        owners = torch.cat([joints.repeat_interleave(values.shape[2]) for joints, values in self.generators])
        result = values.new_empty(len(values), len(owners), len(owners))
        tree = (self.tree.parents, self.tree.deepest_first, len(self.tree.parents))
        given = (blocks, self.matrices.contiguous(), *tree, owners, values, len(owners), result, len(result))
        compiled.call("subtree_gram", values.dtype, *given)
        return result

    def _gram(self, blocks: Tensor, rows: slice) -> Tensor:
        matrices, generators = self.matrices[rows], [(joints, values[rows]) for joints, values in self.generators]
        batch, count = matrices.shape[:2]
        near = matrices.transpose(0, 1).reshape(count, -1, 4) @ blocks
        near = near.view(count, batch, 4, count, 4).permute(1, 3, 0, 2, 4).reshape(batch, count, -1, 4)
        both = self.tree.add_up(near @ matrices.mT)  # (batch, second joint, first joint and row, 4)
        both = both.view(batch, count, count, 4, 4).permute(0, 2, 3, 1, 4).reshape(batch, count, 4, -1)
        both = self.tree.add_up(both)
        halves = [(values.flatten(2, 3) @ both[:, joints]).view(batch, -1, 3, count, 4) for joints, values in generators]
        half = torch.cat(halves, dim=1).permute(0, 3, 1, 2, 4).flatten(3)  # (batch, joint, control, 12)
        parts = [half[:, joints] @ values.flatten(3).mT for joints, values in generators]
        return torch.cat([part.transpose(1, 2).flatten(2) for part in parts], dim=2)

    def _chosen(self, values: Tensor) -> Tensor:
        """Of values `(batch, motion, other)` those of the kept controls, scaled."""
        if self.mix is not None:
            mix = self.mix if self.columns is None else self.mix[:, self.columns]
            return (mix if self.scale is None else mix * self.scale).to(values).T @ values
        values = values if self.columns is None else values.index_select(1, self.columns)
        return values if self.scale is None else values * self.scale[:, None]
