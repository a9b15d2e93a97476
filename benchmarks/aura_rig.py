"""Meta's Aura (Apache-2.0) as a folder of shapes, and performances carried between it and ARKit's shapes by name."""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.animation.live_link import timecode
from riginv.animation.table import write_rows
from riginv.rig.arkit import LIVE_LINK_SHAPES

EXAMPLE = Path(__file__).parent.parent / "examples/studio_face"
# ARKit's shapes of the left side, and the control of Aura that does the same; the right side is alike.
LEFT = {
    "EyeBlinkLeft": "eyesClosed_L",
    "EyeLookDownLeft": "eyesLookDown_L",
    "EyeLookUpLeft": "eyesLookUp_L",
    "EyeSquintLeft": "lidTightener_L",
    "EyeWideLeft": "upperLidRaiser_L",
    "MouthSmileLeft": "lipCornerPuller_L",
    "MouthFrownLeft": "lipCornerDepressor_L",
    "MouthDimpleLeft": "dimpler_L",
    "MouthStretchLeft": "lipStretcher_L",
    "MouthPressLeft": "lipPressor_L",
    "MouthLowerDownLeft": "mouthLowerDown_L",
    "MouthUpperUpLeft": "upperLipRaiser_L",
    "BrowDownLeft": "browDown_L",
    "BrowOuterUpLeft": "outerBrowRaiser_L",
    "CheekSquintLeft": "cheekRaiser_L",
    "NoseSneerLeft": "noseWrinkler_L",
}
OTHERS = {
    "EyeLookInLeft": "eyesLookRight_L",
    "EyeLookOutLeft": "eyesLookLeft_L",
    "EyeLookInRight": "eyesLookLeft_R",
    "EyeLookOutRight": "eyesLookRight_R",
    "JawForward": "jawThrust",
    "JawLeft": "jawSidewaysLeft",
    "JawRight": "jawSidewaysRight",
    "JawOpen": "jawDrop",
    "MouthLeft": "mouthLeft",
    "MouthRight": "mouthRight",
    "MouthClose": "lipsToward_LB lipsToward_LT lipsToward_RB lipsToward_RT",
    "MouthFunnel": "lipFunneler_LB lipFunneler_LT lipFunneler_RB lipFunneler_RT",
    "MouthPucker": "lipPucker_L lipPucker_R",
    "MouthRollLower": "lipSuck_LB lipSuck_RB",
    "MouthRollUpper": "lipSuck_LT lipSuck_RT",
    "MouthShrugLower": "chinRaiser_B",
    "MouthShrugUpper": "chinRaiser_T",
    "BrowInnerUp": "innerBrowRaiser_L innerBrowRaiser_R",
    "CheekPuff": "cheekPuff_L cheekPuff_R",
}
PAIRS = {arkit: names.split() for arkit, names in {**LEFT, **OTHERS}.items()} | {
    arkit.replace("Left", "Right"): [name[:-1] + "R"] for arkit, name in LEFT.items()
}


class Aura(NamedTuple):
    """What was written, by name in the folder: Aura's animation for itself and for ARKit's shapes, and a recording for Aura."""

    animation: str
    as_recording: str
    take: str


def write_aura(source: Path, folder: Path, take: Path | None) -> Aura:
    """Write the folder `aura` of shapes, cm, and the performances; `take`: a recording of ARKit's shapes."""
    sys.path.insert(0, str(EXAMPLE))
    from studio_face.convert import FPS, convert

    if not (folder / "aura").exists():
        convert(source / "shapes.npz", source / "logic.json", source / "animation.npz", folder / "aura")
    animation = "aura/takes/shapes.npz"
    with np.load(folder / animation) as curves:
        controls, names = curves["controls"], curves["names"].tolist()
    weights = np.zeros((len(controls), len(LIVE_LINK_SHAPES)))
    for arkit, parts in PAIRS.items():
        columns = [names.index(part) for part in parts]
        weights[:, LIVE_LINK_SHAPES.index(arkit)] = controls[:, columns].mean(axis=1)
    rows = [[timecode(number / FPS), len(LIVE_LINK_SHAPES), *row] for number, row in enumerate(weights.tolist())]
    write_rows(folder / "aura_as_recording.csv", ["Timecode", "BlendShapeCount", *LIVE_LINK_SHAPES], rows)
    if take is None:
        return Aura(animation, "aura_as_recording.csv", "")
    recorded = np.genfromtxt(take, delimiter=",", names=True, dtype=None, encoding="utf-8")
    played = np.zeros((len(recorded), len(names)), np.float32)
    for arkit, parts in PAIRS.items():
        played[:, [names.index(part) for part in parts]] = np.clip(recorded[arkit], 0, 1)[:, None]
    np.savez(folder / "take_for_aura.npz", controls=played, names=np.array(names), fps=FPS)
    return Aura(animation, "aura_as_recording.csv", "take_for_aura.npz")
