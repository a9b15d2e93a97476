"""Named poses of the body."""


def _both(**controls: float) -> dict[str, float]:
    return {f"{side}_{name}": value for name, value in controls.items() for side in ("left", "right")}


EXPRESSIONS: dict[str, dict[str, float]] = {
    "t-pose": _both(shoulder_raise=47, elbow_bend=-38),
    "at ease": _both(shoulder_raise=-38, elbow_bend=-25, fist=15),
    "stride": {
        **_both(shoulder_raise=-38, elbow_bend=-10, fist=25),
        **{"left_hip_bend": 30, "left_knee_bend": 8, "left_ankle_bend": 8, "right_hip_bend": -22, "right_knee_bend": 25},
        **{"right_foot_roll": 25, "left_shoulder_swing": -25, "right_shoulder_swing": 30, "spine_twist": -10},
    },
    "sit": {**_both(hip_bend=90, knee_bend=90, shoulder_raise=-30, shoulder_swing=20, elbow_bend=10), "root_move_y": -350},
    "wave": {
        "right_shoulder_raise": 75,
        "right_elbow_bend": 60,
        "right_shoulder_twist": -60,
        "right_spread": 18,
        "left_shoulder_raise": -38,
        "head_side": -8,
        "spine_side": -8,
    },
    "reach": {
        **{"left_shoulder_raise": 120, "left_clavicle_raise": 30, "left_elbow_bend": -38, "spine_side": -20, "neck_bend": -25},
        **{"right_shoulder_raise": -35, "right_foot_roll": 30, "left_foot_roll": 40, "left_spread": 15},
    },
    "fists": {**_both(shoulder_raise=-20, shoulder_swing=45, elbow_bend=75, fist=60, thumb_curl=20), "spine_bend": 12},
    "point": {
        **{"right_shoulder_raise": 35, "right_shoulder_swing": 60, "right_elbow_bend": -38, "right_fist": 60},
        **{"right_index_curl": -30, "right_index_bend": -20, "left_shoulder_raise": -38, "root_turn": 20},
    },
    "bow": {"spine_bend": 60, "neck_bend": 25, "head_bend": 15, **_both(hip_bend=20, shoulder_raise=-35)},
    "twist": {"spine_twist": 45, "neck_twist": 35, **_both(shoulder_raise=40, elbow_bend=-20, hip_twist=10)},
    "lunge": {
        **{"left_hip_bend": 75, "left_knee_bend": 80, "right_hip_bend": -28, "right_knee_bend": 30, "right_foot_roll": 30},
        **{"root_move_y": -190, **_both(shoulder_raise=20)},
    },
    "shout": {"jaw_open": 28, "head_bend": -18, **_both(shoulder_raise=-10, elbow_bend=50, fist=50), "spine_bend": -15},
}
