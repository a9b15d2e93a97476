"""BVH: the joints of a rig that has a skeleton, in centimetres and degrees, one row for every frame."""

from pathlib import Path

import numpy as np
import scipy
import torch

from riginv.animation.animation import Animation
from riginv.animation.resampling import fill_gaps
from riginv.animation.shapes import SKELETON
from riginv.animation.skeletons import LocalPoses, local_poses
from riginv.animation.text import unwrap_angles
from riginv.errors import InputError
from riginv.geometry.kinematics import Skeleton
from riginv.rig.interface import RigBackend
from riginv.runs.files import write_text

FILE = "skeleton.bvh"
CM = 0.1  # per mm
TRANSLATION, ROTATION = "Xposition Yposition Zposition", "Zrotation Yrotation Xrotation"


def check(rig: RigBackend) -> None:
    """Raise InputError for a rig without joints."""
    if rig.skeleton() is None:
        raise InputError(f"formats: bvh holds joints, and rig '{rig.name}' has none that make {SKELETON}: leave it out")


@torch.no_grad()
def write(path: Path, animation: Animation) -> None:
    """Write the skeleton at rest, and for each frame the root's position and the joints' rotations.

    A BVH cannot omit frames: gaps are filled.
    """
    skeleton = animation.rig.skeleton()
    assert skeleton is not None
    poses = local_poses(skeleton, fill_gaps(animation))
    angles = scipy.spatial.transform.Rotation.from_matrix(poses.rotations.reshape(-1, 3, 3)).as_euler("ZYX", degrees=True)
    angles = unwrap_angles(angles.reshape(*poses.rotations.shape[:2], 3))
    moving = _moving(poses)
    order = _order(skeleton)
    columns = []
    for joint in order:
        if moving[joint]:
            columns.append(poses.translations[:, joint] * CM)
        columns.append(angles[:, joint])
    table = np.concatenate(columns, axis=1) + 0.0
    rows = [" ".join(f"{value:.6f}" for value in row) for row in table.tolist()]
    head = ["HIERARCHY", *_joint(skeleton, order[0], moving, 0), "MOTION", f"Frames: {len(rows)}"]
    write_text(path, "\n".join([*head, f"Frame Time: {1 / animation.fps:.9f}", *rows]) + "\n")


def _moving(poses: LocalPoses) -> np.ndarray:
    """Whether each joint translates against its parent: the root, and others if the rig stretches."""
    moving = np.ptp(poses.translations, axis=0).max(axis=1) > 1e-3
    moving[0] = True
    return moving


def _order(skeleton: Skeleton) -> list[int]:
    """The joints in depth-first order."""
    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(skeleton.parents):
        children.setdefault(parent, []).append(joint)
    order, waiting = [], [children[-1][0]]
    while waiting:
        joint = waiting.pop()
        order.append(joint)
        waiting += reversed(children.get(joint, []))
    return order


def _joint(skeleton: Skeleton, joint: int, moving: np.ndarray, depth: int) -> list[str]:
    """The lines of a joint and its descendants."""
    pad, parent = "\t" * depth, skeleton.parents[joint]
    offset = (skeleton.heads[joint] - (skeleton.heads[parent] if parent >= 0 else 0)) * CM
    channels = f"CHANNELS 6 {TRANSLATION} {ROTATION}" if moving[joint] else f"CHANNELS 3 {ROTATION}"
    lines = [f"{pad}{'ROOT' if parent < 0 else 'JOINT'} {skeleton.joint_names[joint].replace(' ', '_')}", f"{pad}{{"]
    lines += [f"{pad}\tOFFSET {_triple(offset)}", f"{pad}\t{channels}"]
    children = [child for child, above in enumerate(skeleton.parents) if above == joint]
    for child in children:
        lines += _joint(skeleton, child, moving, depth + 1)
    if not children:
        end = (skeleton.tails[joint] - skeleton.heads[joint]) * CM
        lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET {_triple(end)}", f"{pad}\t}}"]
    return [*lines, f"{pad}}}"]


def _triple(values: torch.Tensor) -> str:
    return " ".join(f"{value + 0.0:.6f}" for value in values.tolist())
