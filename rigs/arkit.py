"""The 52 shapes of ARKit, and which shapes of a rig they are, however these are spelled."""

import re

ARKIT_NAMES = (
    "browDownLeft browDownRight browInnerUp browOuterUpLeft browOuterUpRight cheekPuff cheekSquintLeft cheekSquintRight "
    "eyeBlinkLeft eyeBlinkRight eyeLookDownLeft eyeLookDownRight eyeLookInLeft eyeLookInRight eyeLookOutLeft "
    "eyeLookOutRight eyeLookUpLeft eyeLookUpRight eyeSquintLeft eyeSquintRight eyeWideLeft eyeWideRight jawForward jawLeft "
    "jawOpen jawRight mouthClose mouthDimpleLeft mouthDimpleRight mouthFrownLeft mouthFrownRight mouthFunnel mouthLeft "
    "mouthLowerDownLeft mouthLowerDownRight mouthPressLeft mouthPressRight mouthPucker mouthRight mouthRollLower "
    "mouthRollUpper mouthShrugLower mouthShrugUpper mouthSmileLeft mouthSmileRight mouthStretchLeft mouthStretchRight "
    "mouthUpperUpLeft mouthUpperUpRight noseSneerLeft noseSneerRight tongueOut"
).split()

SIDES = {"l": "left", "r": "right"}


def arkit_targets(names: list[str]) -> dict[str, str]:
    """The shape that stands for each ARKit shape, by ARKit's name, in ARKit's order.

    Case does not matter, nor what stands before the last dot or colon (`blendShape1.jawOpen`), nor underscores; `_L` and `_R`
    at the end are Left and Right. Where two could stand for one, the one spelled exactly as ARKit's does, or
    else the first.
    """
    found: dict[str, str] = {}
    for name in names:
        found.setdefault(_plain(name), name)
    exact = set(names)
    return {name: name if name in exact else found[name.lower()] for name in ARKIT_NAMES if name.lower() in found}


def _plain(name: str) -> str:
    stem = re.split(r"[.:]", name)[-1]
    side = re.fullmatch(r"(.+)[_\- ]([lLrR])", stem)
    if side:
        stem = side[1] + SIDES[side[2].lower()]
    return re.sub(r"[_\- ]", "", stem).lower()
