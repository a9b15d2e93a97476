"""Controls of the body: names, ranges, and the joint axes that they rotate.

Angles are degrees, lengths millimetres. A control of several joints is a macro; it and the controls of single joints add up.
Signs are anatomical: 0 is the rest pose, and a positive bend folds the joint in its natural direction. `left` is the body's.
"""

from typing import NamedTuple

from riginv.rig.interface import Control
from rigs.body.skeleton import FIRST, LAST, MIDDLE

FINGERS = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "little": 5}
SIDES = {"left": ".L", "right": ".R"}
MOVES = ("root_move_x", "root_move_y", "root_move_z")


class JointDrive(NamedTuple):
    """Rotation of a joint by a control: degrees about one of its axes per degree of the control."""

    control: str
    joint: str
    axis: int
    factor: float


# control: lower, upper, then (joint, axis, factor) of each joint that it drives.
Entry = tuple[float, float, list[tuple[str, int, float]]]


def central_controls() -> dict[str, Entry]:
    """Root, spine, neck, head and jaw."""
    spine = [f"spine0{number}" for number in range(5, 0, -1)]  # from the pelvis up
    neck = ["neck01", "neck02", "neck03"]
    entries: dict[str, Entry] = {
        "root_turn": (-180, 180, [("root", FIRST, 1.0)]),
        "root_pitch": (-90, 90, [("root", MIDDLE, 1.0)]),
        "root_roll": (-90, 90, [("root", LAST, 1.0)]),
        "spine_bend": (-40, 80, [(joint, FIRST, 0.2) for joint in spine]),
        "spine_side": (-40, 40, [(joint, MIDDLE, -0.2) for joint in spine]),
        "spine_twist": (-50, 50, [(joint, LAST, 0.2) for joint in spine]),
        "neck_bend": (-40, 40, [(joint, FIRST, 1 / 3) for joint in neck]),
        "neck_side": (-30, 30, [(joint, MIDDLE, -1 / 3) for joint in neck]),
        "neck_twist": (-45, 45, [(joint, LAST, 1 / 3) for joint in neck]),
        "head_bend": (-25, 25, [("head", FIRST, 1.0)]),
        "head_side": (-15, 15, [("head", MIDDLE, -1.0)]),
        "head_twist": (-30, 30, [("head", LAST, 1.0)]),
        "jaw_open": (0, 30, [("jaw", FIRST, 1.0)]),
        "jaw_side": (-8, 8, [("jaw", MIDDLE, -1.0)]),
    }
    for number, joint in enumerate(spine, start=1):
        entries[f"spine{number}_bend"] = (-12, 15, [(joint, FIRST, 1.0)])
        entries[f"spine{number}_side"] = (-10, 10, [(joint, MIDDLE, -1.0)])
        entries[f"spine{number}_twist"] = (-10, 10, [(joint, LAST, 1.0)])
    return entries


def leg_controls() -> dict[str, Entry]:
    return {
        "hip_bend": (-30, 120, [("upperleg01", FIRST, -1.0)]),
        "hip_side": (-30, 60, [("upperleg01", MIDDLE, -1.0)]),
        "hip_twist": (-45, 45, [("upperleg01", LAST, 0.4), ("upperleg02", LAST, 0.6)]),
        "knee_bend": (-5, 145, [("lowerleg01", FIRST, 1.0)]),
        "knee_twist": (-25, 25, [("lowerleg01", LAST, 0.4), ("lowerleg02", LAST, 0.6)]),
        "ankle_bend": (-45, 30, [("foot", FIRST, -1.0)]),
        "ankle_roll": (-25, 25, [("foot", LAST, 1.0)]),
        "ankle_turn": (-20, 20, [("foot", MIDDLE, 1.0)]),
        "toes_bend": (-40, 60, [("toe1-1", FIRST, -1.0)]),
        "foot_roll": (-25, 50, [("foot", FIRST, 1.0), ("toe1-1", FIRST, -1.0)]),
    }


def arm_controls() -> dict[str, Entry]:
    """One arm without its hand."""
    return {
        "clavicle_raise": (-15, 35, [("clavicle", FIRST, 0.6), ("shoulder01", FIRST, 0.4)]),
        "clavicle_forward": (-20, 30, [("clavicle", MIDDLE, -0.6), ("shoulder01", MIDDLE, -0.4)]),
        "shoulder_raise": (-45, 130, [("upperarm01", FIRST, 1.0)]),
        "shoulder_swing": (-45, 90, [("upperarm01", MIDDLE, -1.0)]),
        "shoulder_twist": (-70, 70, [("upperarm01", LAST, 0.5), ("upperarm02", LAST, 0.5)]),
        "elbow_bend": (-40, 100, [("lowerarm01", FIRST, 1.0)]),
        "forearm_twist": (-80, 80, [("lowerarm01", LAST, 0.3), ("lowerarm02", LAST, 0.4), ("wrist", LAST, 0.3)]),
        "wrist_bend": (-65, 70, [("wrist", FIRST, 1.0)]),
        "wrist_side": (-30, 25, [("wrist", MIDDLE, 1.0)]),
    }


def hand_controls() -> dict[str, Entry]:
    long = {name: number for name, number in FINGERS.items() if name != "thumb"}
    fist = [(f"finger{number}-{bone}", FIRST, 1.0) for number in long.values() for bone in (1, 2, 3)]
    fist += [("finger1-1", FIRST, 0.3), ("finger1-2", FIRST, 0.5), ("finger1-3", FIRST, 0.8)]
    entries: dict[str, Entry] = {
        "fist": (-10, 60, fist),
        "spread": (-10, 20, [(f"finger{n}-1", MIDDLE, factor) for n, factor in zip((2, 3, 4, 5), (0.9, 0.2, -0.5, -1.0))]),
        "cup": (0, 20, [("metacarpal3", FIRST, 0.5), ("metacarpal4", FIRST, 1.0)]),
        "thumb_curl": (-25, 45, [(f"finger1-{bone}", FIRST, factor) for bone, factor in zip((1, 2, 3), (0.5, 0.8, 1.0))]),
        "thumb_bend": (-20, 25, [("finger1-1", FIRST, 1.0)]),
        "thumb_side": (-25, 35, [("finger1-1", MIDDLE, 1.0)]),
        "thumb_twist": (-20, 20, [("finger1-1", LAST, 1.0)]),
        "thumb_middle_bend": (-15, 25, [("finger1-2", FIRST, 1.0)]),
        "thumb_tip_bend": (-20, 30, [("finger1-3", FIRST, 1.0)]),
    }
    for name, number in long.items():
        entries[f"{name}_curl"] = (-30, 60, [(f"finger{number}-{bone}", FIRST, 1.0) for bone in (1, 2, 3)])
        entries[f"{name}_bend"] = (-20, 20, [(f"finger{number}-1", FIRST, 1.0)])
        entries[f"{name}_side"] = (-15, 15, [(f"finger{number}-1", MIDDLE, 1.0)])
        entries[f"{name}_middle_bend"] = (-15, 25, [(f"finger{number}-2", FIRST, 1.0)])
        entries[f"{name}_tip_bend"] = (-15, 25, [(f"finger{number}-3", FIRST, 1.0)])
    return entries


def build_controls() -> tuple[list[Control], list[JointDrive]]:
    """All controls in the rig's order, and the joints that they rotate."""
    controls = [Control(name, -1000.0, 1000.0, unit="mm") for name in MOVES]
    drives: list[JointDrive] = []

    def add(name: str, entry: Entry, ending: str) -> None:
        lower, upper, joints = entry
        controls.append(Control(name, float(lower), float(upper), unit="deg"))
        drives.extend(JointDrive(name, joint + ending, axis, factor) for joint, axis, factor in joints)

    for name, entry in central_controls().items():
        add(name, entry, "")
    for side, ending in SIDES.items():
        for name, entry in (leg_controls() | arm_controls() | hand_controls()).items():
            add(f"{side}_{name}", entry, ending)
    return controls, drives
