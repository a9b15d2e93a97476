"""Rigid motion of a frame, in NumPy."""

from dataclasses import dataclass

import numpy as np
import scipy


@dataclass(frozen=True)
class Motion:
    """A rigid motion from the rig's frame to that of a scan: x becomes `rotation x + shift`.

    Attributes:
        rotation: `(3, 3)`.
        shift: `(3,)`, mm.
    """

    rotation: np.ndarray
    shift: np.ndarray

    @classmethod
    def identity(cls) -> "Motion":
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: np.ndarray) -> "Motion":
        """From `(4, 4)`."""
        return cls(np.asarray(matrix[:3, :3], np.float64), np.asarray(matrix[:3, 3], np.float64))

    @property
    def matrix(self) -> np.ndarray:
        """As `(4, 4)`."""
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.rotation, self.shift
        return result

    def apply(self, points: np.ndarray) -> np.ndarray:
        return points @ self.rotation.T + self.shift

    def undo(self, points: np.ndarray) -> np.ndarray:
        return (points - self.shift) @ self.rotation

    def undo_direction(self, directions: np.ndarray) -> np.ndarray:
        return directions @ self.rotation

    def after(self, rotation: np.ndarray, shift: np.ndarray, centre: np.ndarray) -> "Motion":
        """This motion after a small one in the rig's frame.

        Args:
            rotation: rotation vector, radians, about `centre`.
            shift: mm.
        """
        small = scipy.spatial.transform.Rotation.from_rotvec(rotation).as_matrix()
        moved = centre + shift - small @ centre
        return Motion(self.rotation @ small, self.rotation @ moved + self.shift)


def fit_motion(source: np.ndarray, target: np.ndarray, weights: np.ndarray) -> Motion:
    """The rigid motion from source to target points `(point, 3)`, by weighted least squares."""
    total = max(weights.sum(), 1e-12)
    source_mean, target_mean = weights @ source / total, weights @ target / total
    left, _, right = np.linalg.svd((target - target_mean).T @ (weights[:, None] * (source - source_mean)))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    rotation = left @ flip @ right
    return Motion(rotation, target_mean - rotation @ source_mean)
