"""The face's 137 controls, and which of them drive which primary shapes, along which curve.

An animator's set: the 52 ARKit controls under their own names, one control for each half of a split shape and for each
further shape, two-sided controls where two shapes oppose each other, and macros that move several shapes.
"""

from typing import NamedTuple

from riginv.geometry.curves import Curve, Key
from riginv.rig.arkit import ARKIT_NAMES
from riginv.rig.interface import Control
from rigs.face.shapes import ARKIT_SPLIT, UNITS_SPLIT, UNITS_WHOLE

SIDES = ("Left", "Right")

# Curves of one-sided controls from (0, 0) to (1, 1): the handles at both ends as offsets from the keys. None starts flat,
# so that every control has a gradient at its neutral value.
STYLES = {
    "even": ((0.3, 0.3), (-0.3, -0.3)),
    "soft": ((0.4, 0.22), (-0.25, -0.32)),
    "eager": ((0.25, 0.38), (-0.45, -0.25)),
    "settling": ((0.35, 0.24), (-0.35, -0.24)),
    "late": ((0.45, 0.18), (-0.2, -0.34)),
}


class Driver(NamedTuple):
    """A driven key: a control drives a primary shape along a curve."""

    control: str
    shape: str
    curve: Curve


# Controls in [-1, 1]: the shapes on the negative and on the positive side.
TWO_SIDED = {
    "gazeHorizontal": (("eyeLookInLeft", "eyeLookOutRight"), ("eyeLookOutLeft", "eyeLookInRight")),
    "gazeVertical": (("eyeLookDownLeft", "eyeLookDownRight"), ("eyeLookUpLeft", "eyeLookUpRight")),
    "jawSide": (("jawRight",), ("jawLeft",)),
    "mouthSide": (("mouthRight",), ("mouthLeft",)),
    "mouthWidth": (("mouthNarrow",), ("mouthWide",)),
    "upperLip": (("upperLipDown",), ("upperLipUp",)),
    "lowerLip": (("lowerLipDown",), ("lowerLipUp",)),
    "noseTip": (("noseTipDown",), ("noseTipUp",)),
    **{f"lid{side}": ((f"lidClose{side}",), (f"lidRaise{side}",)) for side in SIDES},
    **{f"brow{side}": ((f"browDrop{side}",), (f"browRaise{side}",)) for side in SIDES},
    **{f"mouthCorner{side}": ((f"mouthCornerDown{side}",), (f"mouthCornerUp{side}",)) for side in SIDES},
    **{f"upperLipSide{side}": ((f"upperLipSideDown{side}",), (f"upperLipSideUp{side}",)) for side in SIDES},
    **{f"lowerLipSide{side}": ((f"lowerLipSideDown{side}",), (f"lowerLipSideUp{side}",)) for side in SIDES},
}

# Macros in [0, 1]: the shapes they move, and how far.
MACROS = {
    "blink": {"eyeBlink{side}": 1.0, "browDown{side}": 0.15},
    "smile": {"mouthSmile{side}": 0.9, "cheekSquint{side}": 0.6, "laughLine{side}": 0.5, "eyeSquint{side}": 0.3},
    "sadness": {"mouthFrown{side}": 0.8, "browInnerRaise{side}": 0.9, "mouthShrugLower{side}": 0.4, "lidClose{side}": 0.2},
    "surprise": {"browInnerUp{side}": 0.8, "browOuterUp{side}": 0.8, "eyeWide{side}": 0.7, "jawOpen": 0.35},
    "anger": {"browDown{side}": 0.9, "noseSneer{side}": 0.6, "lidSlit{side}": 0.4, "mouthPress{side}": 0.5},
}

SINGLE_SIDED = (
    "lidSlit",
    "browInnerRaise",
    "browOuterRaise",
    "nostrilFlare",
    "noseWrinkle",
    "cheekSuck",
    "cheekRaise",
    "eyeBag",
)

# Curve style by the prefix of the name of the driven shape; the first match counts.
STYLE_OF = {
    "eyeLook": "even",
    "eyeBlink": "settling",
    "lid": "settling",
    "eye": "soft",
    "jawOpen": "eager",
    "jaw": "even",
    "brow": "soft",
    "mouthSmile": "eager",
    "mouthFrown": "settling",
    "mouthRoll": "late",
    "mouthPress": "late",
    "mouth": "soft",
    "lip": "settling",
    "corner": "eager",
    "cheek": "late",
    "nose": "soft",
}


def build_controls() -> tuple[list[Control], list[Driver]]:
    """The 137 controls in the rig's order, and their drivers."""
    controls: list[Control] = []
    drivers: list[Driver] = []

    def one_sided(name: str, shapes: dict[str, float]) -> None:
        controls.append(Control(name))
        drivers.extend(Driver(name, shape, rising(style(shape), amount)) for shape, amount in shapes.items())

    for name in ARKIT_NAMES:
        one_sided(name, dict.fromkeys(_halves(name) if name in ARKIT_SPLIT else [name], 1.0))
    single = [half for name in (*ARKIT_SPLIT, *UNITS_SPLIT, "laughLine", *SINGLE_SIDED) for half in _halves(name)]
    for name in (*single, *UNITS_WHOLE):
        one_sided(name, {name: 1.0})
    for name, (negative, positive) in TWO_SIDED.items():
        controls.append(Control(name, lower=-1.0))
        drivers.extend(Driver(name, shape, falling(style(shape))) for shape in negative)
        drivers.extend(Driver(name, shape, rising(style(shape))) for shape in positive)
    for name, shapes in MACROS.items():
        one_sided(name, {full: amount for shape, amount in shapes.items() for full in _sides(shape)})
    return controls, drivers


def style(shape: str) -> str:
    """Key in `STYLES` of the curve that drives a shape."""
    return next((style for start, style in STYLE_OF.items() if shape.startswith(start)), "even")


def rising(style: str, amount: float = 1.0) -> Curve:
    """A driven key from (0, 0) to (1, amount)."""
    (start_x, start_y), (end_x, end_y) = STYLES[style]
    return [Key(0.0, 0.0, right=(start_x, amount * start_y)), Key(1.0, amount, left=(end_x, amount * end_y))]


def falling(style: str) -> Curve:
    """A driven key from (-1, 1) to (0, 0): `rising`, mirrored, for the negative side of a two-sided control."""
    (start_x, start_y), (end_x, end_y) = STYLES[style]
    return [Key(-1.0, 1.0, right=(-end_x, end_y)), Key(0.0, 0.0, left=(-start_x, start_y))]


def _halves(name: str) -> list[str]:
    return [name + side for side in SIDES]


def _sides(name: str) -> list[str]:
    return [name.format(side=side) for side in SIDES] if "{side}" in name else [name]
