"""Controls of joints, with their orders of rotation and ranges, from the motion in the file's animations."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from riginv.geometry.euler import ORDERS, continuous_angles, euler_angles
from riginv.rig.interface import Control
from rigs.gltf.avatar import Avatar
from rigs.gltf.frames import Frames
from rigs.gltf.node_motion import NodeMotion

Choice = Literal["auto"] | bool
ANGLES, MOVES, SCALES = ("rx", "ry", "rz"), ("tx", "ty", "tz"), ("sx", "sy", "sz")
LIMIT_DEG = 60.0  # of an angle that no animation takes farther
MARGIN, MARGIN_DEG, MARGIN_SIZE = 0.1, 5.0, 0.01  # beyond what animations do: of their range, degrees, of the mesh's size
LARGE_DEG = 60.0  # of the middle angle: beyond it another order of rotation may serve better
FARTHEST_DEG = 360.0 * 20  # limit of an angle: twenty turns
CURVES = 128  # of joints whose angles are followed together
SCALE_RANGE = 1.25  # of joints that no animation scales, on either side of 1
LEAST_SCALE, MOST_SCALE = 1e-3, 1e3
UNIFORM = 1e-3  # difference of scales along the three axes that counts as none


class Drives(NamedTuple):
    """The effects of joint controls, in the order of the controls: angles of all frames, then translations, then scales.

    Attributes:
        controls: with their ranges.
        orders: the axes of each frame's rotations, the outermost first, `(frame, 3)`.
        moved: frames with translations, three controls each, `(moved,)`.
        scaled: frame of each scale control, `(scale,)`.
        scaled_axes: the axes that it scales, 1 or 0, `(scale, 3)`.
    """

    controls: list[Control]
    orders: Tensor
    moved: Tensor
    scaled: Tensor
    scaled_axes: Tensor


def joint_drives(
    avatar: Avatar,
    frames: Frames,
    motions: dict[int, list[NodeMotion]],
    limit_deg: float | None,
    translation: Choice,
    scale: Choice,
) -> Drives:
    """The controls of joints.

    Args:
        limit_deg: of all angles, on either side of 0; None: from the animations, `LIMIT_DEG` at least.
        translation, scale: for all joints or none; `auto`: for those that an animation moves or scales, and translations
            for the roots of an animated skeleton.
    """
    controls: list[Control] = []
    rotations = [[one.rotations for one in motions.get(node, []) if one.rotations is not None] for node in frames.nodes]
    if limit_deg is None:
        orders = torch.stack([_best_order(angles) for angles in rotations])
        limits = _angle_limits(rotations, orders)
    else:
        orders = torch.tensor([ORDERS[0]] * len(frames.names))
        limits = [[(-limit_deg, limit_deg)] * 3] * len(frames.names)
    for name, angles in zip(frames.names, limits):
        controls += [Control(f"{name}.{axis}", low, high, unit="deg") for axis, (low, high) in zip(ANGLES, angles)]
    moved = _chosen(frames, motions, translation, lambda one: one.translations is not None, roots=True)
    for number in moved:
        controls += _translation_controls(avatar, frames, number, motions.get(frames.nodes[number], []))
    scaled, axes = [], []
    for number in _chosen(frames, motions, scale, lambda one: one.scales is not None):
        scale_controls, their_axes = _scale_controls(frames.names[number], motions.get(frames.nodes[number], []))
        controls += scale_controls
        scaled += [number] * len(scale_controls)
        axes += their_axes
    moved_frames, scaled_frames = (torch.tensor(numbers, dtype=torch.long) for numbers in (moved, scaled))
    return Drives(controls, orders, moved_frames, scaled_frames, torch.tensor(axes).view(-1, 3))


def _translation_controls(avatar: Avatar, frames: Frames, number: int, motions: list[NodeMotion]) -> list[Control]:
    """Three translations of a frame, mm along its parent's axes."""
    size = float(np.linalg.norm(np.ptp(avatar.rest, axis=0)))
    unit = avatar.mm * frames.parent_scales[number].numpy()
    found = [unit * one.translations for one in motions if one.translations is not None]
    away = np.concatenate([np.zeros((1, 3)), *found])
    more = MARGIN * np.ptp(away, axis=0) + (MARGIN_SIZE if found else 1.0) * size
    reach = zip(MOVES, (away.min(axis=0) - more).tolist(), (away.max(axis=0) + more).tolist())
    return [Control(f"{frames.names[number]}.{axis}", low, high, unit="mm") for axis, low, high in reach]


def _scale_controls(name: str, motions: list[NodeMotion]) -> tuple[list[Control], list[list[float]]]:
    """The scales of a frame, and which axes each acts on: one for all where animations scale them alike."""
    found = [one.scales for one in motions if one.scales is not None]
    values = np.concatenate([np.ones((1, 3)), *found])
    margin = 1 + MARGIN if found else SCALE_RANGE
    low = (values.min(axis=0) / margin).clip(LEAST_SCALE).tolist()
    high = (values.max(axis=0) * margin).clip(None, MOST_SCALE).tolist()
    if found and np.ptp(values, axis=1).max() < UNIFORM:
        return [Control(f"{name}.s", min(low), max(high), 1.0)], [[1.0, 1.0, 1.0]]
    controls = [Control(f"{name}.{axis}", least, most, 1.0) for axis, least, most in zip(SCALES, low, high)]
    return controls, np.eye(3).tolist()


def _chosen(
    frames: Frames,
    motions: dict[int, list[NodeMotion]],
    choice: Choice,
    does: Callable[[NodeMotion], bool],
    roots: bool = False,
) -> list[int]:
    """The frames that have a kind of control."""
    numbers = range(len(frames.names))
    if choice != "auto":
        return [number for number in numbers if choice]
    animated = roots and any(frames.nodes[number] in motions for number in numbers)
    return [
        number
        for number in numbers
        if any(does(one) for one in motions.get(frames.nodes[number], [])) or (animated and frames.parents[number] < 0)
    ]


def _best_order(samples: list[np.ndarray]) -> Tensor:
    """The order of rotations whose middle angle stays farthest from gimbal lock; XYZ unless that comes near it."""
    found = torch.tensor(np.concatenate(samples))[:, None] if samples else torch.eye(3, dtype=torch.float64)[None, None]
    largest = []
    for order in ORDERS:
        angles = euler_angles(found, torch.tensor([order]))
        largest.append(float(angles[..., order[1]].abs().max()))
    best = 0 if largest[0] <= np.radians(LARGE_DEG) else int(np.argmin(largest))
    return torch.tensor(ORDERS[best])


def _angle_limits(rotations: list[list[np.ndarray]], orders: Tensor) -> list[list[tuple[float, float]]]:
    """Limits of the three angles of each frame, degrees, that all animations keep."""
    low, high = np.zeros((len(orders), 3)), np.zeros((len(orders), 3))
    curves = [(number, samples) for number, each in enumerate(rotations) for samples in each]
    for first in range(0, len(curves), CURVES):
        numbers = np.array([number for number, _ in curves[first : first + CURVES]])
        some = [samples for _, samples in curves[first : first + CURVES]]
        longest = max(map(len, some))
        padded = np.stack([np.concatenate([one, np.repeat(one[-1:], longest - len(one), axis=0)]) for one in some], axis=1)
        of_curve, far = orders[numbers], torch.full((len(some), 3), np.radians(FARTHEST_DEG), dtype=torch.float64)
        angles = continuous_angles(euler_angles(torch.tensor(padded), of_curve), of_curve, -far, far).numpy()
        np.minimum.at(low, numbers, np.degrees(angles.min(axis=0)))
        np.maximum.at(high, numbers, np.degrees(angles.max(axis=0)))
    more = MARGIN_DEG + MARGIN * (high - low)
    low, high = np.minimum(low - more, -LIMIT_DEG), np.maximum(high + more, LIMIT_DEG)
    return [list(zip(*each)) for each in zip(low.tolist(), high.tolist())]
