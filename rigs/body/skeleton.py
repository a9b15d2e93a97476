"""MakeHuman's skeleton, without the bones of the face, and the rotation axes of its joints.

A joint has three orthogonal axes, `first`, `middle` and `last`, and rotates about the last one first: R = R_first R_middle
R_last. The last axis is along the bone (twist); the first is that of the largest motion. Where the middle angle is 90 degrees,
first and last coincide (gimbal lock).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

SIDED = (
    *("upperleg01", "upperleg02", "lowerleg01", "lowerleg02", "foot", "toe1-1"),
    *("clavicle", "shoulder01", "upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist"),
    *(f"metacarpal{number}" for number in range(1, 5)),
    *(f"finger{finger}-{bone}" for finger in range(1, 6) for bone in range(1, 4)),
)
CENTRAL = ("root", *(f"spine0{number}" for number in range(5, 0, -1)), "neck01", "neck02", "neck03", "head", "jaw")
KEPT = (*CENTRAL, *(f"{name}.{side}" for side in "LR" for name in ("pelvis", *SIDED)))
FIRST, MIDDLE, LAST = range(3)
X, Y, Z = np.eye(3)
MIRROR = np.diag([1.0, -1.0, -1.0])  # of rotation axes, left to right: one angle then rotates both sides symmetrically


@dataclass(frozen=True)
class Skeleton:
    """Joints at rest, in MakeHuman's names (`upperarm01.L`), mm, y up, z out of the face.

    Attributes:
        names: of the joints.
        parents: index of each joint's parent, -1 for the root.
        heads, tails: ends of each bone, `(joint, 3)`.
        rolls: Blender's roll angle of each bone, radians.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    heads: np.ndarray
    tails: np.ndarray
    rolls: np.ndarray

    @cached_property
    def number(self) -> dict[str, int]:
        """Index of each joint by name."""
        return {name: number for number, name in enumerate(self.names)}


def joint_frames(skeleton: Skeleton) -> np.ndarray:
    """Rotation matrices `(joint, 3, 3)` whose columns are the first, last and middle axis of each joint."""
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
        """Unit normal of the left palm, outwards."""
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
