"""Forward kinematics: from local to world transforms of joints, depth by depth of the tree; and `Skeleton`.

A transform is a 3x4 matrix, the last column its translation: it maps a point p to M[:, :3] p + M[:, 3].
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.errors import InputError

LEAF = 0.3  # length of a leaf bone, as a fraction of the distance to its parent


def apply_motion(motion: Tensor, vertices: Tensor) -> Tensor:
    """Apply motions `(frame, 4, 4)` to meshes `(frame, vertex, 3)`."""
    return vertices @ motion[:, :3, :3].mT + motion[:, None, :3, 3]


def remove_motion(motion: Tensor, vertices: Tensor) -> Tensor:
    """The inverse of `apply_motion`."""
    return (vertices - motion[:, None, :3, 3]) @ motion[:, :3, :3]


def with_last_row(transforms: Float[Tensor, "*batch 3 4"]) -> Float[Tensor, "*batch 4 4"]:
    """The same transforms with the row 0 0 0 1."""
    row = torch.tensor([0.0, 0.0, 0.0, 1.0]).to(transforms).expand(*transforms.shape[:-2], 1, 4)
    return torch.cat([transforms, row], dim=-2)


def tree_levels(parents: Sequence[int], names: Sequence[str] | None = None) -> list[Tensor]:
    """The joints of each depth of a tree, roots first; joints may be in any order, and there may be several roots.

    Args:
        parents: the parent of each joint, -1 for a root.
        names: of the joints, for messages; None: their indices.

    Returns:
        The indices of the joints of each depth, `(joint,)`.

    Raises:
        InputError: there are no joints, a parent is not among them, or joints form a cycle; the message names the joint.
    """
    count = len(parents)
    names = [str(number) for number in range(count)] if names is None else names
    if not count:
        raise InputError("a skeleton needs at least one joint")
    for joint, parent in enumerate(parents):
        if not -1 <= parent < count:
            raise InputError(
                f"joint '{names[joint]}' has parent number {parent}, expected 0 to {count - 1}, or -1 for a root: "
                f"correct its parent"
            )
    levels: list[list[int]] = []
    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(parents):
        children.setdefault(parent, []).append(joint)
    level = children.get(-1, [])
    while level:
        levels.append(level)
        level = [child for joint in level for child in children.get(joint, [])]
    hanging = sorted(set(range(count)) - {joint for level in levels for joint in level})
    if hanging:
        cycle = _cycle(parents, hanging[0])
        chain = " -> ".join(f"'{names[joint]}'" for joint in [*cycle, cycle[0]])
        raise InputError(f"the joints form a cycle, each the child of the next: {chain}; give one of them another parent")
    return [torch.tensor(level) for level in levels]


def _cycle(parents: Sequence[int], joint: int) -> list[int]:
    """The joints of the cycle that the ancestors of `joint` run into."""
    seen: list[int] = []
    while joint not in seen:
        seen.append(joint)
        joint = parents[joint]
    return seen[seen.index(joint) :]


def compose(outer: Float[Tensor, "*#transforms 3 4"], inner: Float[Tensor, "*#transforms 3 4"]) -> Float[Tensor, "... 3 4"]:
    """The transform `(..., 3, 4)` that applies `inner` first, then `outer`."""
    product = outer[..., :3] @ inner
    return torch.cat([product[..., :3], product[..., 3:] + outer[..., 3:]], dim=-1)


def invert(transforms: Float[Tensor, "*transforms 3 4"]) -> Float[Tensor, "*transforms 3 4"]:
    """The inverse `(..., 3, 4)` of affine transforms, which may scale and shear."""
    linear = torch.linalg.inv(transforms[..., :3])
    return torch.cat([linear, -linear @ transforms[..., 3:]], dim=-1)


def transform_from(
    rotations: Float[Tensor, "*transforms 3 3"], translations: Float[Tensor, "*transforms 3"]
) -> Float[Tensor, "*transforms 3 4"]:
    """Transforms `(..., 3, 4)` from rotations `(..., 3, 3)` and translations `(..., 3)`."""
    return torch.cat([rotations, translations[..., None]], dim=-1)


def forward_kinematics(local: Float[Tensor, "batch joint 3 4"], parents: Sequence[int]) -> Float[Tensor, "batch joint 3 4"]:
    """World transforms from transforms relative to the parents, batched over the joints of one depth.

    Args:
        local: a root's is its world transform.
        parents: as for `tree_levels`.
    """
    levels, order = _by_depth(tuple(parents), local.device)
    worlds: list[Tensor] = []
    for joints, above in levels:
        here = local[:, joints]
        worlds.append(compose(worlds[-1][:, above], here) if worlds else here)
    return torch.cat(worlds, dim=1)[:, order]


@functools.lru_cache(maxsize=64)
def _by_depth(parents: tuple[int, ...], device: torch.device) -> tuple[list[tuple[Tensor, Tensor]], Tensor]:
    """The joints of each depth and the places of their parents in the depth above, and the place of each joint among all."""
    with torch.inference_mode(False):  # kept for later calls, which may need gradients
        of_joint, place = torch.tensor(parents), torch.empty(len(parents), dtype=torch.long)
        levels = []
        for joints in tree_levels(parents):
            levels.append((joints.to(device), place[of_joint[joints]].to(device)))  # of roots: not used
            place[joints] = torch.arange(len(joints))
        return levels, torch.cat([joints for joints, _ in levels]).argsort()


def bone_tails(heads: Float[Tensor, "joint 3"], parents: Sequence[int]) -> Float[Tensor, "joint 3"]:
    """Ends of the bones, for display: the mean of the children, or beyond a leaf joint."""
    tails = torch.zeros_like(heads)
    for joint, parent in enumerate(parents):
        children = [child for child, above in enumerate(parents) if above == joint]
        along = heads[joint] - heads[parent] if parent >= 0 else heads.new_tensor([0.0, 100.0, 0.0])
        tails[joint] = heads[children].mean(dim=0) if children else heads[joint] + LEAF * along
    return tails


@dataclass(frozen=True)
class Skeleton:
    """Joints of linear blend skinning, without rotation at rest.

    Attributes:
        joint_names: unique; parents come before their children, the root first.
        parents: the index of each joint's parent, -1 for the root.
        heads: `(joint, 3)`, mm: the joints' positions at rest.
        tails: `(joint, 3)`, mm: the ends of their bones, for display.
        weights: `(vertex, joint)`, each row summing to 1.
        pose: controls `(batch, control)` to the joints' world transforms `(batch, joint, 3, 4)`, mm; at rest the identity
            and `heads`.
    """

    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    heads: Tensor
    tails: Tensor
    weights: Tensor
    pose: Callable[[Tensor], Tensor]
