"""The 52 ARKit shapes, and a rig's shapes that correspond to them, however these are spelled, split or merged."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

LIVE_LINK_SHAPES = (  # in the order of the Live Link Face app's columns
    "EyeBlinkLeft EyeLookDownLeft EyeLookInLeft EyeLookOutLeft EyeLookUpLeft EyeSquintLeft EyeWideLeft EyeBlinkRight "
    "EyeLookDownRight EyeLookInRight EyeLookOutRight EyeLookUpRight EyeSquintRight EyeWideRight JawForward JawRight JawLeft "
    "JawOpen MouthClose MouthFunnel MouthPucker MouthRight MouthLeft MouthSmileLeft MouthSmileRight MouthFrownLeft "
    "MouthFrownRight MouthDimpleLeft MouthDimpleRight MouthStretchLeft MouthStretchRight MouthRollLower MouthRollUpper "
    "MouthShrugLower MouthShrugUpper MouthPressLeft MouthPressRight MouthLowerDownLeft MouthLowerDownRight MouthUpperUpLeft "
    "MouthUpperUpRight BrowDownLeft BrowDownRight BrowInnerUp BrowOuterUpLeft BrowOuterUpRight CheekPuff CheekSquintLeft "
    "CheekSquintRight NoseSneerLeft NoseSneerRight TongueOut"
).split()
ARKIT_NAMES = sorted(name[0].lower() + name[1:] for name in LIVE_LINK_SHAPES)
DIRECTIONAL = ("jaw", "mouth")  # their Left and Right are two directions, not the two halves of one shape
SIDES = {"l": "left", "r": "right", "left": "left", "right": "right"}
SIDE_LAST = re.compile(r"(.+?)[_\-. ](l|r|left|right)", re.IGNORECASE)
SIDE_FIRST = re.compile(r"(l|r|left|right)[_\-. ](.+)", re.IGNORECASE)
SIDE_LETTER = re.compile(r"(.*[a-z])([LR])")


class ArkitParts(NamedTuple):
    """The shapes of a rig that correspond to one ARKit shape.

    Attributes:
        names: of the rig's shapes; two where the rig splits the shape left and right.
        factor: the ARKit shape is their sum times this: 0.5 where one shape of the rig is both the left and the right one.
    """

    names: tuple[str, ...]
    factor: float = 1.0


def plain_name(name: str) -> str:
    """A name in lower case without prefix (`blendShape1.`) and separators, its side (`_L`, `.R`, `L_` ...) spelled out last."""
    side = ""
    if last := SIDE_LAST.fullmatch(name):
        name, side = last[1], SIDES[last[2].lower()]
    stem = re.split(r"[.:]", name)[-1]
    if not side and (first := SIDE_FIRST.fullmatch(stem)):
        stem, side = first[2], SIDES[first[1].lower()]
    elif not side and (letter := SIDE_LETTER.fullmatch(stem)):
        stem, side = letter[1], SIDES[letter[2].lower()]
    return re.sub(r"[_\- ]", "", stem).lower() + side


def arkit_parts(names: Sequence[str]) -> dict[str, ArkitParts]:
    """The rig's shapes for each ARKit shape, by ARKit's name, sorted.

    The shape of the same name; else its left and right halves, which add up to it (`browInnerUp_L`, `browInnerUp_R`); else the
    shape that the rig has in place of a left and a right one (`mouthSmile`), half of which is each of the two. Of several
    candidates the one that is spelled as ARKit's is taken, or else the first.
    """
    by_plain: dict[str, str] = {}
    for name in names:
        by_plain.setdefault(plain_name(name), name)
    exact, found = set(names), {}
    for name in ARKIT_NAMES:
        plain, merged = name.lower(), name.removesuffix("Left").removesuffix("Right")
        halves = merged.lower() + "left", merged.lower() + "right"
        if name in exact or plain in by_plain:
            found[name] = ArkitParts((name if name in exact else by_plain[plain],))
        elif merged == name and all(half in by_plain for half in halves):
            found[name] = ArkitParts(tuple(by_plain[half] for half in halves))
        elif merged != name and merged not in DIRECTIONAL and merged.lower() in by_plain and not set(halves) & by_plain.keys():
            found[name] = ArkitParts((by_plain[merged.lower()],), 0.5)
    return found


def arkit_deltas(parts: Mapping[str, ArkitParts], deltas: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The delta `(vertex, 3)` of each ARKit shape, mm, from those of the rig's shapes by name."""
    return {arkit: factor * sum((deltas[name] for name in names), torch.zeros(())) for arkit, (names, factor) in parts.items()}
