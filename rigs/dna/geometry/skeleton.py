"""Joints: neutral pose, and forward kinematics from changes of joints to skinning matrices.

Transforms have the batch last, `(joint, 3, 4, batch)`, and are multiplied entry by entry: several times as fast for hundreds of
joints as `riginv.geometry.kinematics`, which multiplies matrix by matrix.
"""

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.geometry.kinematics import invert, transform_from, tree_levels
from rigs.dna.format import DnaFile
from rigs.dna.format.layers import Definition, Vectors
from rigs.dna.geometry.space import Space
from rigs.dna.logic.joint_stage import JointStage
from rigs.dna.logic.joints import JointChanges
from rigs.dna.logic.layout import Layout, Stage
from rigs.dna.logic.rotations import Angles


def apply(outer: Tensor, inner: Tensor) -> Tensor:
    """The products `(joint, 3, column, batch)` of matrices `(joint, 3, 3, batch)` with `(joint, 3, column, batch)`."""
    columns, rows = outer.unbind(2), inner.unbind(1)  # unbind has one backward step, indexing many
    product = columns[0][:, :, None] * rows[0][:, None]
    for column, row in zip(columns[1:], rows[1:]):
        product = torch.addcmul(product, column[:, :, None], row[:, None])
    return product


def compose(outer: Tensor, inner: Tensor) -> Tensor:
    """Composition of transforms `(joint, 3, 4, batch)`: `inner` is applied first."""
    linear, offsets = outer.split((3, 1), dim=2)
    first, last = apply(linear, inner).split((3, 1), dim=2)
    return torch.cat([first, last + offsets], dim=2)


def stacked(vectors: Vectors, layout: Layout, what: str, count: int | None = None) -> np.ndarray:
    """Vectors as `(vector, 3)` float64.

    Raises:
        InputError: their coordinates differ in number, or are not as many as expected, or are NaN or infinite.
    """
    layout.check_lengths(what, x=len(vectors.xs), y=len(vectors.ys), z=len(vectors.zs))
    if count is not None and len(vectors.xs) != count:
        raise layout.wrong(f"{what}: {len(vectors.xs)} vectors, expected {count}")
    result = np.stack([vectors.xs, vectors.ys, vectors.zs], axis=1).astype(np.float64)
    layout.check_finite(what, result)
    return result


def joint_parents(file: DnaFile) -> list[int]:
    """The parent of each joint, -1 for a root.

    Raises:
        InputError: a parent is not there, or joints form a cycle.
    """
    definition = file.need(Definition)
    if len(definition.parents) != len(definition.joints):
        raise InputError(
            f"{file.path}: {len(definition.parents)} joints have parents, {len(definition.joints)} have names: the file is "
            f"damaged; export it again"
        )
    parents = [-1 if parent == joint else int(parent) for joint, parent in enumerate(definition.parents)]
    try:
        if parents:
            tree_levels(parents, definition.joints)
    except InputError as error:
        raise InputError(f"{file.path}: {error}") from None
    return parents


def with_ancestors(parents: list[int], joints: np.ndarray) -> np.ndarray:
    """Joints and their ancestors, in ascending order."""
    kept: set[int] = set()
    for joint in joints.tolist():
        while joint >= 0 and joint not in kept:
            kept.add(joint)
            joint = parents[joint]
    return np.array(sorted(kept), dtype=np.int64)


class Skeleton(Stage):
    """The joints of a file in riginv's space, relative to a centre.

    Args:
        joints: indices of the evaluated joints, with all ancestors, `(joint,)`.
        centre: `(3,)`, mm: the origin, near the mesh for small rounding errors.

    Attributes:
        neutral: world transforms at rest, `(joint, 3, 4)`, mm.
    """

    rotations: Tensor
    offsets: Tensor
    root: Tensor
    neutral: Tensor
    inverse_neutral: Tensor
    by_level: Tensor
    order: Tensor

    def __init__(self, file: DnaFile, layout: Layout, space: Space, joints: np.ndarray, centre: np.ndarray) -> None:
        super().__init__()
        definition = file.need(Definition)
        count, parents = len(definition.joints), joint_parents(file)
        offsets = stacked(definition.neutral_translations, layout, "the neutral translations of joints", count)[joints]
        eulers = stacked(definition.neutral_rotations, layout, "the neutral rotations of joints", count)[joints]
        number = {int(joint): index for index, joint in enumerate(joints)}
        self.parents = [number.get(parents[joint], -1) for joint in joints.tolist()]
        self.levels = tree_levels(self.parents) if len(joints) else []
        rotations = Angles.of(file, layout).matrices(torch.tensor(eulers)).reshape(-1, 3, 3, 1)
        axes = torch.tensor(space.axes)
        root = transform_from(axes, -torch.tensor(centre))[None, :, :, None]
        self.unit_mm = space.unit_mm
        self.keep(rotations=rotations, offsets=torch.tensor(offsets * space.unit_mm)[..., None], root=root)
        self._keep_order()
        neutral = self._worlds(self.rotations, self.offsets) if len(joints) else root.new_zeros(0, 3, 4, 1)
        inverse_neutral = invert(neutral[..., 0])[..., None]
        self.keep(neutral=neutral[..., 0], inverse_neutral=inverse_neutral)

    def _keep_order(self) -> None:
        """Register the joints by depth in the tree, and for each depth the indices of their parents in the depth above."""
        index = torch.zeros(len(self.parents), dtype=torch.long)
        of_joint = torch.tensor(self.parents, dtype=torch.long)
        for depth, level in enumerate(self.levels):
            above = index[of_joint[level]] if depth else level
            self.keep(**{f"above{depth}": above})
            index[level] = torch.arange(len(level))
        if self.levels:
            by_level = torch.cat(self.levels)
            self.keep(by_level=by_level, order=by_level.argsort())

    def worlds(self, stage: JointStage, changes: JointChanges) -> Tensor:
        """The world transforms `(joint, 3, 4, batch)` of the joints, mm, for changes of joints."""
        translations, angles, scales = changes.attributes.split(3, dim=1)
        rotations = stage.rotations(angles, changes)
        linear = apply(self.rotations.to(rotations), rotations) * (1 + scales[:, None])
        return self._worlds(linear, self.offsets.to(rotations) + self.unit_mm * translations)

    def skinning(self, worlds: Tensor) -> Tensor:
        """The skinning matrices `(joint, 3, 4, batch)` of world transforms."""
        return compose(worlds, self.inverse_neutral.to(worlds))

    def neutral_values(self, file: DnaFile, angles: Angles) -> dict[str, np.ndarray]:
        """The neutral pose as the file states it: translation, rotation and scale `(joint, 9)`, and with quaternions."""
        definition = file.need(Definition)
        parts = [definition.neutral_translations, definition.neutral_rotations]
        offsets, eulers = (np.stack([part.xs, part.ys, part.zs], axis=1).astype(np.float64) for part in parts)
        ones = np.ones_like(offsets)
        quaternions = angles.quaternions(torch.tensor(eulers)).numpy()
        return {
            "": np.concatenate([offsets, eulers, ones], axis=1),
            "_quaternion": np.concatenate([offsets, quaternions, ones], axis=1),
        }

    def _worlds(self, linear: Tensor, offsets: Tensor) -> Tensor:
        """World transforms `(joint, 3, 4, batch)` from local ones, batched over the joints of each depth."""
        local = torch.cat([linear, offsets[:, :, None].expand(*linear.shape[:2], 1, -1)], dim=2)
        first, *others = local.index_select(0, self.by_level).split([len(level) for level in self.levels])
        worlds = [compose(self.root.to(local), first)]
        for depth, here in enumerate(others, start=1):
            worlds.append(compose(worlds[-1].index_select(0, self.get_buffer(f"above{depth}")), here))
        return torch.cat(worlds).index_select(0, self.order)
