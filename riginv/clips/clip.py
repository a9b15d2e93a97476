"""A clip ready for a rig: in millimetres, y up, the chosen frames, NaN for unknown vertices."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from riginv.clips.motion_check import MotionCheck
from riginv.clips.sequence import MeshSequence
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.rig.mesh_sets import MeshSet

MAX_RADIUS_MM = 1e7  # 10 km: a vertex farther from the origin means a damaged file


class Clip(MeshSet):
    """A sequence of meshes with its units, as a set of meshes to invert.

    Args:
        sequence: the meshes as the file has them.
        units: what its numbers mean.
        first, last: frame numbers of the source, both included; None: its first, its last.
        exclude: frames whose vertices are treated as unknown, as numbers or ranges such as `120-135`.

    Attributes:
        frame_numbers: `(frame,)`, as in the source.
        excluded: whether a frame was excluded, `(frame,)`.
        motion_check: how it moves, over the frames read so far.

    Raises:
        InputError: the chosen frames do not exist.
    """

    fps: float
    frame_numbers: Tensor

    def __init__(
        self,
        sequence: MeshSequence,
        units: ClipUnits,
        first: int | None = None,
        last: int | None = None,
        exclude: Sequence[int | str] = (),
    ) -> None:
        numbers = sequence.frame_numbers
        inside = frames_between(sequence.path, numbers, first, last)
        self.sequence, self.units, self.offset = sequence, units, int(np.argmax(inside))
        controls = None if sequence.controls is None else torch.from_numpy(sequence.controls[inside])
        super().__init__("clip", units.fps, controls, torch.tensor(numbers[inside]))
        self.excluded = excluded_frames(sequence.path, self.frame_numbers, exclude)
        self.motion_check = MotionCheck(self.frame_numbers, units.fps, bool(units.unit_source))

    def __len__(self) -> int:
        return len(self.frame_numbers)

    def vertices(self, start: int, stop: int) -> Tensor:
        points = torch.from_numpy(self.sequence.read(self.offset + start, self.offset + stop))
        if not bool((self.units.axes == torch.eye(3)).all()):
            points = points @ self.units.axes.T
        if self.units.mm != 1:
            points = points * self.units.mm
        excluded = self.excluded[start:stop]
        if bool(excluded.any()):
            points = torch.where(excluded[:, None, None], torch.nan, points)
        if not (len(points) and bool(torch.stack(points.aminmax()).abs().max() <= MAX_RADIUS_MM)):  # NaN, or too far
            points = torch.where(torch.isfinite(points).all(dim=2, keepdim=True), points, torch.nan)
            self._check(points, start)
        self.motion_check.add(start, points)
        return points

    def _check(self, points: Tensor, start: int) -> None:
        far = points.abs().nan_to_num(0.0).amax(dim=2) > MAX_RADIUS_MM
        if bool(far.any()):
            frame, vertex = far.nonzero()[0].tolist()
            raise InputError(
                f"{self.sequence.path}: vertex {vertex} of frame {int(self.frame_numbers[start + frame])} lies farther than "
                f"{MAX_RADIUS_MM / 1e6:g} km away: the file is damaged, or the unit is wrong; frames.exclude leaves a frame out"
            )


def frames_between(path: str, numbers: np.ndarray, first: int | None, last: int | None) -> np.ndarray:
    """Whether each frame `(frame,)` lies between two frame numbers, both included; None: the first, the last.

    Raises:
        InputError: none does.
    """
    first, last = (given if given is not None else int(own) for given, own in ((first, numbers[0]), (last, numbers[-1])))
    inside = (numbers >= first) & (numbers <= last)
    if not inside.any():
        raise InputError(
            f"{path}: frames {first} to {last} were requested, and it has {numbers[0]} to {numbers[-1]}: none left"
        )
    return inside


def excluded_frames(path: str, numbers: Tensor, exclude: Sequence[int | str]) -> Tensor:
    """Whether each frame `(frame,)` is one that `frames.exclude` names.

    Raises:
        InputError: an entry is no frame or range of the clip, or all frames are excluded.
    """
    excluded = frames_named(path, numbers, exclude, "frames.exclude")
    if bool(excluded.all()):
        raise InputError(f"{path}: frames.exclude leaves no frame of {len(excluded)}")
    return excluded


def frames_named(path: str, numbers: Tensor, entries: Sequence[int | str], key: str) -> Tensor:
    """Whether each frame `(frame,)` is one of `entries`, numbers or ranges such as `120-135`.

    Args:
        key: of the config, for messages.

    Raises:
        InputError: an entry is no frame or range of the clip.
    """
    found = torch.zeros(len(numbers), dtype=torch.bool)
    if not isinstance(entries, list | tuple):
        raise InputError(f"{key} is {entries!r}, expected a list of frames: {key}=[17,120-135]")
    for entry in entries:
        low, dash, high = str(entry).partition("-")
        try:
            ends = int(low), int(high if dash else low)
        except ValueError:
            raise InputError(f"{key} holds {entry!r}, expected a frame's number, or two as '120-135'") from None
        span = (numbers >= ends[0]) & (numbers <= ends[1])
        if not bool(span.any()):
            raise InputError(f"{key} names {entry}, and {path} has frames {int(numbers[0])} to {int(numbers[-1])}")
        found |= span
    return found
