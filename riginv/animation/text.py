"""What the text formats share."""

import numpy as np
from scipy.spatial.transform import Rotation

from riginv.animation.animation import Animation

TRANSLATION_COLUMNS = ("motion_x_mm", "motion_y_mm", "motion_z_mm")
ROTATION_COLUMNS = ("motion_turn_x_deg", "motion_turn_y_deg", "motion_turn_z_deg")


def digits(values: np.ndarray) -> list[list[str]]:
    """Numbers `(row, column)` as texts of seven digits, which is what float32 holds; -0 is 0."""
    return [[f"{value:.7g}" for value in row] for row in (np.asarray(values, np.float64) + 0.0).tolist()]


def rigid_motion_columns(animation: Animation) -> np.ndarray | None:
    """The rigid motion as `(frame, 6)`: along x, y, z, mm, and about x, y, z, degrees; None where nothing was removed.

    It turns about x first, then about y, then about z, about axes that stay (Maya's rotate order xyz, Blender's XYZ), and
    without jumps by 360 degrees.
    """
    if animation.motion is None:
        return None
    motion = animation.motion.detach().cpu().double().numpy()
    turns = Rotation.from_matrix(motion[:, :3, :3]).as_euler("xyz", degrees=True)
    return np.concatenate([motion[:, :3, 3], unwrap_angles(turns)], axis=1)


def unwrap_angles(turns: np.ndarray) -> np.ndarray:
    """Three angles each `(frame, ..., 3)`, degrees, of turns about three axes, as near to those of the frame before as can be.

    Whole turns may be added to each; and where the middle angle passes 90 degrees, a, b, c is the same as a + 180, 180 - b,
    c + 180.
    """
    smooth = turns.copy()
    for frame in range(1, len(turns)):
        before = smooth[frame - 1]
        first, middle, last = np.moveaxis(turns[frame], -1, 0)
        choices = np.stack([turns[frame], np.stack([first + 180, 180 - middle, last + 180], axis=-1)])
        choices += 360 * np.round((before - choices) / 360)
        change = np.abs(choices - before).sum(axis=-1)
        smooth[frame] = np.where((change[0] <= change[1])[..., None], choices[0], choices[1])
    return smooth
