"""What the text formats share."""

import numpy as np
from scipy.spatial.transform import Rotation

from riginv.curves.animation import Animation

MOVE_COLUMNS = ("motion_x_mm", "motion_y_mm", "motion_z_mm")
TURN_COLUMNS = ("motion_turn_x_deg", "motion_turn_y_deg", "motion_turn_z_deg")


def digits(values: np.ndarray) -> list[list[str]]:
    """Numbers `(row, column)` as texts of seven digits, which is what float32 holds; -0 is 0."""
    return [[f"{value:.7g}" for value in row] for row in (np.asarray(values, np.float64) + 0.0).tolist()]


def moves_and_turns(animation: Animation) -> np.ndarray | None:
    """The rigid motion as `(frame, 6)`: along x, y, z, mm, and about x, y, z, degrees; None where nothing was removed.

    It turns about x first, then about y, then about z, about axes that stay (Maya's rotate order xyz, Blender's XYZ), and
    without jumps by 360 degrees.
    """
    if animation.motion is None:
        return None
    motion = animation.motion.detach().cpu().double().numpy()
    turns = Rotation.from_matrix(motion[:, :3, :3]).as_euler("xyz", degrees=True)
    return np.concatenate([motion[:, :3, 3], np.unwrap(turns, axis=0, period=360)], axis=1)
