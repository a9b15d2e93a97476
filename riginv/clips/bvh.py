"""BVH files: the motion of a skeleton, for a rig whose joints have the same names."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
import torch

from riginv.clips.bones import BoneMotion, BonesClip
from riginv.clips.frame_rate import common_rate
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, SourceFacts
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.runs.files import read_bytes

CHANNELS = {f"{axis}{kind}".lower(): (kind, "XYZ".index(axis)) for axis in "XYZ" for kind in ("position", "rotation")}
MOST_JOINTS = 10_000
MOST_BYTES = 100_000_000


class BvhJoint(NamedTuple):
    """A joint of the hierarchy; `channels` are kinds, `position` or `rotation`, and axes."""

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[tuple[str, int], ...]


class BvhClip(BonesClip):
    """A BVH file as a clip of a rig with a skeleton.

    Raises:
        InputError: the file is damaged, or its joints are not the rig's.
    """

    def __init__(self, path: str, options: ReadingOptions, rig: RigBackend | None = None) -> None:
        if rig is None:
            raise InputError(
                f"{path}: the motion of a skeleton needs a rig to become meshes: name it with rig=NAME or bundle=DIR"
            )
        super().__init__(path, read_bvh(Path(path)), rig, SourceFacts("BVH", rate_source="its frame time"))

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> MeshSequence:
        return cls(path, options, rig)


def read_bvh(path: Path) -> BoneMotion:
    """The motion in a BVH file.

    Raises:
        InputError: it is damaged; the message names the line.
    """
    if path.is_file() and path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size:,} bytes, expected at most {MOST_BYTES:,}: split the take")
    lines = [line.split() for line in read_bytes(path).decode("utf-8-sig", "replace").splitlines()]
    joints, at = _hierarchy(path, lines)
    values, seconds = _table(path, lines, at, sum(len(joint.channels) for joint in joints))
    heads = np.zeros((len(joints), 3))
    rotations, positions = np.empty((len(values), len(joints), 3, 3)), np.empty((len(values), len(joints), 3))
    column = 0
    for number, joint in enumerate(joints):
        mine = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        place, local = np.tile(joint.offset, (len(values), 1)), _rotations(joint, mine)
        for (kind, axis), moved in zip(joint.channels, mine.T):
            if kind == "position":
                place[:, axis] = moved
        if joint.parent < 0:
            heads[number], positions[:, number], rotations[:, number] = joint.offset, place, local
            continue
        heads[number] = heads[joint.parent] + joint.offset
        above = rotations[:, joint.parent]
        positions[:, number] = positions[:, joint.parent] + (above @ place[..., None])[..., 0]
        rotations[:, number] = above @ local
    names, parents = tuple(joint.name for joint in joints), tuple(joint.parent for joint in joints)
    at_rest, turned, places = (torch.from_numpy(values) for values in (heads, rotations, positions))
    return BoneMotion(names, parents, at_rest, turned, places, common_rate(1 / seconds))


def _rotations(joint: BvhJoint, values: np.ndarray) -> np.ndarray:
    """Rotations `(frame, 3, 3)` relative to the parent: the first channel is the outermost."""
    axes = "".join("XYZ"[axis] for kind, axis in joint.channels if kind == "rotation")
    angles = values[:, [kind == "rotation" for kind, _ in joint.channels]]
    result = np.tile(np.eye(3), (len(values), 1, 1))
    for axis, each in zip(axes, angles.T):
        result = result @ scipy.spatial.transform.Rotation.from_euler(axis, each[:, None], degrees=True).as_matrix()
    return result


def _hierarchy(path: Path, lines: list[list[str]]) -> tuple[list[BvhJoint], int]:
    """The joints, parents first, and the index of the line after them."""
    joints: list[BvhJoint] = []
    open_joints: list[int] = []  # -1: the end of a bone
    expected = -2  # the joint whose brace comes next
    for at, words in enumerate(lines):
        word = words[0].upper() if words else ""
        if word == "MOTION":
            if open_joints or not joints:
                break
            return joints, at + 1
        if word in ("ROOT", "JOINT") and len(words) > 1:
            if len(joints) == MOST_JOINTS:
                raise InputError(f"{path}: line {at + 1}: more than {MOST_JOINTS:,} joints: no skeleton of a character")
            parent = open_joints[-1] if open_joints else -1
            joints.append(BvhJoint(" ".join(words[1:]).removesuffix("{").strip(), parent, (0.0, 0.0, 0.0), ()))
            expected = len(joints) - 1
        elif word == "END":
            expected = -1
        if words and words[-1].endswith("{"):
            open_joints.append(expected)
        elif word == "OFFSET" and open_joints:
            offset = tuple(_numbers(path, at, words[1:]))
            if len(offset) != 3:
                raise InputError(f"{path}: line {at + 1}: an offset of {len(offset)} numbers, expected 3: export it again")
            if open_joints[-1] >= 0:
                joints[open_joints[-1]] = joints[open_joints[-1]]._replace(offset=offset)
        elif word == "CHANNELS" and open_joints and open_joints[-1] >= 0:
            channels = [CHANNELS.get(name.lower()) for name in words[2:]]
            if words[1:2] != [str(len(channels))] or None in channels:
                raise InputError(f"{path}: line {at + 1}: '{' '.join(words)[:80]}' are no channels: export it again")
            joints[open_joints[-1]] = joints[open_joints[-1]]._replace(channels=tuple(c for c in channels if c))
        elif word == "}" and open_joints:
            open_joints.pop()
    raise InputError(f"{path}: no whole hierarchy before MOTION, expected HIERARCHY, ROOT, joints and MOTION: export it again")


def _table(path: Path, lines: list[list[str]], at: int, columns: int) -> tuple[np.ndarray, float]:
    """The values `(frame, column)`, and the seconds of a frame."""
    head, rows = lines[at : at + 2], [(number, words) for number, words in enumerate(lines) if number >= at + 2 and words]
    frames = head[0][-1] if head and head[0] else ""
    seconds = _numbers(path, at + 1, head[1][-1:]) if len(head) == 2 else []
    if not frames.isdigit() or int(frames) != len(rows) or not rows:
        raise InputError(f"{path}: {len(rows)} rows of motion, and it states '{frames[:20]}' frames: damaged; export it again")
    if not seconds or not 1e-6 < seconds[0] < 1e6:
        raise InputError(f"{path}: line {at + 2}: its frame time is no number of seconds above 0: export it again")
    for number, words in rows:
        if len(words) != columns:
            raise InputError(f"{path}: line {number + 1}: {len(words)} numbers, expected {columns}, one for each channel")
    values = np.array([_numbers(path, number, words) for number, words in rows])
    return values, seconds[0]


def _numbers(path: Path, at: int, words: list[str]) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [np.nan]
    if not np.isfinite(values).all() or max(map(abs, values), default=0.0) > 1e9:
        raise InputError(f"{path}: line {at + 1}: '{' '.join(words)[:60]}', expected finite numbers: export it again")
    return values
