"""The joints of a skinned rig, for software that wants to know them."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Skeleton:
    """Joints that carry a mesh by linear blend skinning; at rest none is turned against the world.

    Attributes:
        joint_names: unique; parents stand before their children, the root first.
        parents: the number of each joint's parent, -1 for the root.
        heads: `(joint, 3)`, mm: where each joint is at rest.
        tails: `(joint, 3)`, mm: where its bone ends, for the eye.
        weights: `(vertex, joint)`, each row summing to 1.
        pose: controls `(batch, control)` to the transforms `(batch, joint, 3, 4)` of the joints in the world, mm; at rest they
            are the identity beside `heads`.
    """

    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    heads: Tensor
    tails: Tensor
    weights: Tensor
    pose: Callable[[Tensor], Tensor]
