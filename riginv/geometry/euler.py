"""Rotations by three angles about coordinate axes, in any order of the axes, with continuous curves of the angles.

An order is a permutation `(first, middle, last)` of the axes 0 to 2: R = R_first R_middle R_last, as roma's and SciPy's 'XYZ'.
Angles are stored by axis, not by position in the order.
"""

from itertools import permutations

import torch
from jaxtyping import Float, Int
from torch import Tensor

ORDERS = tuple(permutations(range(3)))
LOCKED = 1e-3  # cosine of the middle angle below which the first and last axis count as one (gimbal lock)


def axis_rotations(
    angles: Float[Tensor, "*batch joint 3"], orders: Int[Tensor, "joint 3"]
) -> tuple[Float[Tensor, "*batch joint 3 3"], ...]:
    """The rotations about the first, middle and last axis of each joint, for angles in radians."""
    found, eye = [], torch.eye(3, dtype=angles.dtype, device=angles.device)
    for position in range(3):
        axis = orders[:, position]
        angle = angles.gather(-1, axis.expand(angles.shape[:-1])[..., None])[..., None]
        cross = torch.linalg.cross(eye[axis][:, None].expand(-1, 3, -1), eye[None]).mT
        found.append(eye + torch.sin(angle) * cross + (1 - torch.cos(angle)) * (cross @ cross))
    return tuple(found)


def euler_angles(
    rotations: Float[Tensor, "*batch joint 3 3"], orders: Int[Tensor, "joint 3"]
) -> Float[Tensor, "*batch joint 3"]:
    """The angles, radians, of rotations; the middle one within a right angle. In gimbal lock the last one is 0."""
    first, middle, last = orders.unbind(1)
    joints = torch.arange(len(orders), device=orders.device)
    sign = torch.where((middle - first) % 3 == 1, 1.0, -1.0).to(rotations)

    def entry(row: Tensor, column: Tensor) -> Tensor:
        return rotations[..., joints, row, column]

    cosine = torch.hypot(entry(first, first), entry(first, middle))
    of_middle = torch.atan2(sign * entry(first, last), cosine)
    locked = cosine < LOCKED
    of_first = torch.atan2(-sign * entry(middle, last), entry(last, last))
    both = torch.atan2(sign * entry(last, middle), entry(middle, middle))
    of_last = torch.atan2(-sign * entry(first, middle), entry(first, first))
    by_position = torch.stack(
        [torch.where(locked, both, of_first), of_middle, torch.where(locked, torch.zeros_like(of_last), of_last)], dim=-1
    )
    return torch.empty_like(by_position).scatter_(-1, orders.expand(by_position.shape), by_position)


def continuous_angles(
    angles: Float[Tensor, "frame joint 3"],
    orders: Int[Tensor, "joint 3"],
    lower: Float[Tensor, "joint 3"],
    upper: Float[Tensor, "joint 3"],
) -> Float[Tensor, "frame joint 3"]:
    """The same rotations by angles, radians, that change least from frame to frame, within limits where that is possible."""
    found, before = torch.empty_like(angles), torch.zeros_like(angles[0])
    for frame, here in enumerate(angles):
        found[frame] = before = nearest_angles(here, before, orders, lower, upper)
    return found


def nearest_angles(
    angles: Float[Tensor, "*batch joint 3"],
    before: Float[Tensor, "*#batch joint 3"],
    orders: Int[Tensor, "joint 3"],
    lower: Float[Tensor, "joint 3"],
    upper: Float[Tensor, "joint 3"],
) -> Float[Tensor, "*batch joint 3"]:
    """The same rotations by the angles, radians, nearest to others, within limits where that is possible.

    Two triples make one rotation: the second has the first and last angle half a turn further, and half a turn less the middle
    one. Full turns are added to either.
    """
    middle = torch.zeros(orders.shape, dtype=torch.bool, device=angles.device).scatter_(1, orders[:, 1:2], True)
    turn = 2 * torch.pi
    choices = torch.stack([angles, torch.where(middle, torch.pi - angles, angles + torch.pi)])
    choices = choices + turn * ((before - choices) / turn).round()
    choices = choices - turn * ((choices - upper - 1e-4) / turn).ceil().clamp_min(0)
    choices = choices + turn * ((lower - 1e-4 - choices) / turn).ceil().clamp_min(0)
    beyond = (choices - choices.clamp(lower, upper)).abs()
    cost = ((choices - before).abs() + 100 * beyond).sum(dim=-1)
    return torch.where((cost[0] <= cost[1])[..., None], choices[0], choices[1])
