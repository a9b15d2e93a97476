"""The face's 134 primary shapes: the 52 ARKit shapes, MakeHuman's expression units and a few of its morphs.

Shapes of the whole mouth, brow or cheeks are split into a left and a right half.
"""

from typing import NamedTuple

import numpy as np

from riginv.rig.arkit import ARKIT_NAMES
from rigs.geometry.asset import FaceSource

ARKIT_FOLDER = "faceunits01/targets/faceunits"
EXPRESSION_FOLDER = "mpfb2/targets/expression/units"
MORPH_FOLDER = "mpfb2/targets"
BLEND_WIDTH = 12.0  # mm on either side of the midline in which the halves of a split shape overlap

ARKIT_SPLIT = (
    "browInnerUp cheekPuff mouthFunnel mouthPucker mouthRollLower mouthRollUpper mouthShrugLower mouthShrugUpper"
).split()

UNIT_VERSIONS = ("african", "asian", "caucasian")

# Shape -> file of an expression unit (the mean of its versions); `{side}` where there is one file for each side.
UNITS_SIDED = {
    "lidClose": "eye-{side}-closure",
    "lidRaise": "eye-{side}-opened-up",
    "lidSlit": "eye-{side}-slit",
    "browDrop": "eyebrows-{side}-down",
    "browRaise": "eyebrows-{side}-up",
    "browInnerRaise": "eyebrows-{side}-inner-up",
    "browOuterRaise": "eyebrows-{side}-extern-up",
    "nostrilFlare": "nose-{side}-dilatation",
    "noseWrinkle": "nose-{side}-elevation",
}
UNITS_SPLIT = {
    "lipCompress": "mouth-compression",
    "cornerPull": "mouth-corner-puller",
    "cornerDepress": "mouth-depression",
    "cornerRetract": "mouth-retraction",
    "cornerLift": "mouth-upward-retraction",
    "lowerLipDraw": "mouth-depression-retraction",
    "upperLipDraw": "mouth-elevation",
    "lowerLipEvert": "mouth-eversion",
    "lipPart": "mouth-parling",
    "lipBare": "mouth-part-later",
    "lipProtrude": "mouth-protusion",
    "lipPurse": "mouth-pursing",
    "neckTense": "neck-platysma",
}
UNITS_WHOLE = {"nostrilPinch": "nose-compression", "noseDrop": "nose-depression"}

# Shape -> file of a morph; `{side}` where there is one file for each side.
MORPHS_SIDED = {
    "cheekSuck": "cheek/{side}-cheek-volume-decr",
    "cheekRaise": "cheek/{side}-cheek-trans-up",
    "eyeBag": "eyes/{side}-eye-bag-incr",
}
MORPHS_SPLIT = {
    "mouthCornerUp": "mouth/mouth-angles-up",
    "mouthCornerDown": "mouth/mouth-angles-down",
    "upperLipSideUp": "mouth/mouth-upperlip-ext-up",
    "upperLipSideDown": "mouth/mouth-upperlip-ext-down",
    "lowerLipSideUp": "mouth/mouth-lowerlip-ext-up",
    "lowerLipSideDown": "mouth/mouth-lowerlip-ext-down",
    "laughLine": "mouth/mouth-laugh-lines-out",
}
MORPHS_WHOLE = {
    "upperLipUp": "mouth/mouth-upperlip-middle-up",
    "upperLipDown": "mouth/mouth-upperlip-middle-down",
    "lowerLipUp": "mouth/mouth-lowerlip-middle-up",
    "lowerLipDown": "mouth/mouth-lowerlip-middle-down",
    "mouthWide": "mouth/mouth-scale-horiz-incr",
    "mouthNarrow": "mouth/mouth-scale-horiz-decr",
    "noseTipUp": "nose/nose-base-up",
    "noseTipDown": "nose/nose-base-down",
}


class Source(NamedTuple):
    """Source of a shape: the mean of one or more target files, optionally split into a left and a right half."""

    name: str
    files: tuple[str, ...]
    split: bool

    @property
    def shapes(self) -> tuple[str, ...]:
        return (self.name + "Left", self.name + "Right") if self.split else (self.name,)


def sources() -> list[Source]:
    """Sources of the primary shapes, in the rig's order."""
    result = [Source(name, (f"{ARKIT_FOLDER}/{name}.target",), name in ARKIT_SPLIT) for name in ARKIT_NAMES]
    for side, letter in (("left", "l"), ("right", "r")):
        end = side.capitalize()
        result += [Source(name + end, _unit_files(file.format(side=side)), False) for name, file in UNITS_SIDED.items()]
        result += [Source(name + end, _morph_files(file.format(side=letter)), False) for name, file in MORPHS_SIDED.items()]
    for table, files, split in (
        (UNITS_SPLIT, _unit_files, True),
        (UNITS_WHOLE, _unit_files, False),
        (MORPHS_SPLIT, _morph_files, True),
        (MORPHS_WHOLE, _morph_files, False),
    ):
        result += [Source(name, files(file), split) for name, file in table.items()]
    return result


def primary_names() -> list[str]:
    """Names of the 134 primary shapes, in the rig's order."""
    return [name for source in sources() for name in source.shapes]


def build_primaries(face: FaceSource) -> dict[str, np.ndarray]:
    """Deltas `(vertex, 3)`, mm, of the primary shapes by name, in the rig's order."""
    left = _left_fraction(face.rest[:, 0])[:, None]
    shapes: dict[str, np.ndarray] = {}
    for source in sources():
        deltas = face.carried(np.mean([face.target(file) for file in source.files], axis=0))
        halves = (deltas * left, deltas * (1 - left))
        shapes.update(zip(source.shapes, halves if source.split else (deltas,)))
    return shapes


def _unit_files(name: str) -> tuple[str, ...]:
    return tuple(f"{EXPRESSION_FOLDER}/{people}/{name}.target.gz" for people in UNIT_VERSIONS)


def _morph_files(name: str) -> tuple[str, ...]:
    return (f"{MORPH_FOLDER}/{name}.target.gz",)


def _left_fraction(x: np.ndarray) -> np.ndarray:
    """Weight of the left half of a split shape: a smooth step from 0 to 1 across the midline."""
    t = np.clip((x + BLEND_WIDTH) / (2 * BLEND_WIDTH), 0, 1)
    return t * t * (3 - 2 * t)
