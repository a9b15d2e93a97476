"""Colours and named expressions of the face."""

import torch
from torch import Tensor

from rigs.geometry.asset import PARTS

COLORS = {
    "skin": (0.80, 0.62, 0.53),
    "mouth": (0.50, 0.22, 0.22),
    "left_eye": (0.93, 0.92, 0.90),
    "right_eye": (0.93, 0.92, 0.90),
    "upper_teeth": (0.93, 0.91, 0.85),
    "lower_teeth": (0.93, 0.91, 0.85),
    "tongue": (0.75, 0.36, 0.36),
}
PUPIL, IRIS = (0.03, 0.03, 0.03), (0.22, 0.33, 0.40)
PUPIL_DEGREES, IRIS_DEGREES = 14.0, 30.0  # from the optical axis


def _both(**controls: float) -> dict[str, float]:
    return {name + side: value for name, value in controls.items() for side in ("Left", "Right")}


EXPRESSIONS: dict[str, dict[str, float]] = {
    "joy": {"smile": 1.0, "jawOpen": 0.25, **_both(upperLipDraw=0.2)},
    "sadness": {"sadness": 1.0, "gazeVertical": -0.4},
    "anger": {"anger": 1.0, **_both(lowerLipDraw=0.3)},
    "surprise": {"surprise": 1.0, "jawOpen": 0.6},
    "disgust": {**_both(noseSneer=1.0, browDown=0.6, mouthUpperUp=0.7, cheekSquint=0.5), "mouthShrugLower": 0.5},
    "fear": {"browInnerUp": 1.0, **_both(eyeWide=1.0, mouthStretch=0.9, brow=0.5), "jawOpen": 0.3},
    "contempt": {"mouthSmileLeft": 0.5, "mouthDimpleLeft": 0.8, "mouthPressLeft": 0.4, "lidSlitRight": 0.3},
    "wink": {"eyeBlinkLeft": 1.0, "mouthSmileLeft": 0.7, "cheekSquintLeft": 0.7, "mouthSide": 0.2},
    "kiss": {"mouthPucker": 1.0, **_both(lipPurse=0.4, eyeSquint=0.3), "mouthFunnel": 0.15},
    "shout": {"jawOpen": 1.0, **_both(lipBare=0.5, browDown=0.7, noseSneer=0.5, mouthStretch=0.4)},
    "sleep": {"blink": 1.0, "jawOpen": 0.12, "mouthShrugUpper": 0.2},
    "side eye": {"gazeHorizontal": 0.9, "browOuterUpRight": 0.6, "browLeft": -0.5, "mouthSide": -0.4},
}


def paint(rest_vertices: Tensor, part: Tensor) -> Tensor:
    """Vertex colours `(vertex, 3)` in [0, 1], with iris and pupil.

    Args:
        rest_vertices: `(vertex, 3)`, mm.
        part: `(vertex,)` indices into `PARTS`.
    """
    colors = torch.tensor([COLORS[name] for name in PARTS], device=part.device)[part]
    for name in ("left_eye", "right_eye"):
        here = part == PARTS.index(name)
        ball = rest_vertices[here]
        outwards = torch.nn.functional.normalize(ball - (ball.amax(dim=0) + ball.amin(dim=0)) / 2, dim=1)
        degrees = torch.rad2deg(torch.arccos(outwards[:, 2].clamp(-1, 1)))[:, None]
        iris = torch.where(degrees < PUPIL_DEGREES, colors.new_tensor(PUPIL), colors.new_tensor(IRIS))
        colors[here] = torch.where(degrees < IRIS_DEGREES, iris, colors[here])
    return colors
