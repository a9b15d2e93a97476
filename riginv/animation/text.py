"""Numbers and rigid motion as text formats write them."""

import numpy as np
import torch

from riginv.animation.animation import Animation
from riginv.geometry.euler import euler_angles

TRANSLATION_COLUMNS = ("motion_x_mm", "motion_y_mm", "motion_z_mm")
ROTATION_COLUMNS = ("motion_turn_x_deg", "motion_turn_y_deg", "motion_turn_z_deg")


def digits(values: np.ndarray) -> list[list[str]]:
    """Numbers `(row, column)` with seven digits, the precision of float32; -0 becomes 0."""
    return [[f"{value:.7g}" for value in row] for row in (np.asarray(values, np.float64) + 0.0).tolist()]


def rigid_motion_columns(animation: Animation) -> np.ndarray | None:
    """The rigid motion as `(frame, 6)`: translation x, y, z, mm, and rotation about x, y, z, degrees; None if none was removed.

    The rotations are about fixed axes, x first, then y, then z (Maya's rotate order xyz, Blender's XYZ), without jumps by 360
    degrees.
    """
    if animation.motion is None:
        return None
    motion = animation.motion.detach().cpu().double()
    angles = euler_angles(motion[:, None, :3, :3], torch.tensor([[2, 1, 0]]))[:, 0].rad2deg()
    return np.concatenate([motion[:, :3, 3].numpy(), unwrap_angles(angles.numpy())], axis=1)


def unwrap_angles(angles: np.ndarray) -> np.ndarray:
    """Equivalent Euler angles `(frame, ..., 3)`, degrees, as near as possible to those of the frame before.

    Multiples of 360 degrees may be added to each; and a, b, c is equivalent to a + 180, 180 - b, c + 180.
    """
    smooth = angles.copy()
    if not _jumps(angles):
        return smooth
    for frame in range(1, len(angles)):
        before = smooth[frame - 1]
        first, middle, last = np.moveaxis(angles[frame], -1, 0)
        choices = np.stack([angles[frame], np.stack([first + 180, 180 - middle, last + 180], axis=-1)])
        choices += 360 * np.round((before - choices) / 360)
        change = np.abs(choices - before).sum(axis=-1)
        smooth[frame] = np.where((change[0] <= change[1])[..., None], choices[0], choices[1])
    return smooth


def _jumps(angles: np.ndarray) -> bool:
    """Whether equivalent angles may be nearer to those of the frame before: else those are 200 degrees away at least."""
    is_near = (np.abs(np.diff(angles, axis=0)) <= 60).all() and (np.abs(angles[..., 1]) <= 80).all()
    return not bool(is_near)
