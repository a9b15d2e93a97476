"""The axes that each joint turns about, from the geometry of the rest pose.

A joint has three: `first`, `middle` and `last`, orthogonal. It turns about the last one first, then about the middle one,
then about the first: R = R_first R_middle R_last. The last axis runs along the bone, so that it twists; the first one is
that of the largest motion. Where the middle angle is 90 degrees, first and last are one (gimbal lock).
"""

import numpy as np

from rigs.body.skeleton import Skeleton

FIRST, MIDDLE, LAST = range(3)
X, Y, Z = np.eye(3)
MIRROR = np.diag([1.0, -1.0, -1.0])  # of axes of rotation, left to right: one angle then turns both sides alike


def joint_frames(skeleton: Skeleton) -> np.ndarray:
    """For each joint the frame `(joint, 3, 3)` whose columns are its first, last and middle axis, a rotation matrix."""
    bones = _Bones(skeleton)
    frames = np.stack([_frame(name, bones) for name in skeleton.names])
    for name, number in skeleton.number.items():
        if name.endswith(".R"):
            frames[number] = MIRROR @ frames[skeleton.number[name[:-1] + "L"]]
    return frames


class _Bones:
    """Directions between the joints of a skeleton."""

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton

    def head(self, name: str) -> np.ndarray:
        return self.skeleton.heads[self.skeleton.number[name]]

    def along(self, name: str) -> np.ndarray:
        number = self.skeleton.number[name]
        return _unit(self.skeleton.tails[number] - self.skeleton.heads[number])

    def palm(self) -> np.ndarray:
        """Out of the left palm."""
        wrist = self.head("wrist.L")
        return -_unit(np.cross(self.head("finger2-1.L") - wrist, self.head("finger5-1.L") - wrist))


def _frame(name: str, bones: _Bones) -> np.ndarray:
    stem = name.partition(".")[0]
    along = bones.along(name)
    if stem == "root":
        return _orthonormal(first=Y, last=Z)
    if stem in ("clavicle", "shoulder01", "upperarm01", "upperarm02"):
        return _orthonormal(first=Z, last=along)
    if stem in ("lowerarm01", "lowerarm02"):
        return _orthonormal(first=np.cross(bones.along("upperarm02.L"), along), last=along)
    if stem.startswith("finger1"):
        return _orthonormal(first=np.cross(bones.along("finger1-1.L"), bones.along("finger1-3.L")), last=along)
    if stem.startswith(("wrist", "metacarpal", "finger")):
        return _orthonormal(first=np.cross(along, bones.palm()), last=along)
    return _orthonormal(first=X, last=along)


def _orthonormal(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    first = _unit(first - (first @ last) * last)
    return np.stack([first, last, np.cross(first, last)], axis=1)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
