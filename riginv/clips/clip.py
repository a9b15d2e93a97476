"""A clip ready for a rig: millimetres, y up, the frames that were asked for, and NaN where nothing is known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from riginv.clips.motion_check import MotionCheck
from riginv.clips.sequence import MeshSequence
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.rig.mesh_sets import MeshSet

FARTHEST_MM = 1e7  # from the origin that a vertex may lie, 10 km: beyond it a file is damaged


class Clip(MeshSet):
    """A sequence of meshes as a set to invert.

    Args:
        sequence: as read.
        units: of its numbers.
        first, last: the frames to take, both included, as the source counts them; None: from its start, to its end.
        exclude: frames that are not to be believed, as numbers or spans `120-135`: all their vertices count as unknown.

    Attributes:
        frame_numbers: `(frame,)`, as the source counts them.
        excluded: whether a frame was excluded, `(frame,)`.
        motion_check: how it moves, as far as its meshes were read.

    Raises:
        InputError: no frame is left, or one that is named does not exist.
    """

    def __init__(
        self,
        sequence: MeshSequence,
        units: ClipUnits,
        first: int | None = None,
        last: int | None = None,
        exclude: Sequence[Any] = (),
    ) -> None:
        numbers = sequence.frame_numbers
        inside = (numbers >= (numbers[0] if first is None else first)) & (numbers <= (numbers[-1] if last is None else last))
        if not inside.any():
            raise InputError(
                f"{sequence.path}: frames {first} to {last} were asked for, and it has {numbers[0]} to {numbers[-1]}: none left"
            )
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
        points = points * self.units.mm
        points = torch.where(torch.isfinite(points).all(dim=2, keepdim=True), points, torch.nan)
        points[self.excluded[start:stop]] = torch.nan
        self._check(points, start)
        self.motion_check.add(start, points)
        return points

    def _check(self, points: Tensor, start: int) -> None:
        far = points.abs().nan_to_num(0.0).amax(dim=2) > FARTHEST_MM
        if bool(far.any()):
            frame, vertex = far.nonzero()[0].tolist()
            raise InputError(
                f"{self.sequence.path}: vertex {vertex} of frame {int(self.frame_numbers[start + frame])} lies farther than "
                f"{FARTHEST_MM / 1e6:g} km away: the file is damaged, or the unit is wrong; frames.exclude leaves a frame out"
            )


def excluded_frames(path: str, numbers: Tensor, exclude: Sequence[Any]) -> Tensor:
    """Which of the frames with some numbers `(frame,)` are named by `frames.exclude`.

    Raises:
        InputError: an entry is no frame or span of the clip, or none is left.
    """
    gone = torch.zeros(len(numbers), dtype=torch.bool)
    if not isinstance(exclude, list | tuple):
        raise InputError(f"frames.exclude is {exclude!r}, expected a list of frames: frames.exclude=[17,120-135]")
    for entry in exclude:
        low, dash, high = str(entry).partition("-")
        try:
            ends = int(low), int(high if dash else low)
        except ValueError:
            raise InputError(f"frames.exclude holds {entry!r}, expected a frame's number, or two as '120-135'") from None
        span = (numbers >= ends[0]) & (numbers <= ends[1])
        if not bool(span.any()):
            raise InputError(f"frames.exclude names {entry}, and {path} has frames {int(numbers[0])} to {int(numbers[-1])}")
        gone |= span
    if bool(gone.all()):
        raise InputError(f"{path}: frames.exclude leaves no frame of {len(gone)}")
    return gone
