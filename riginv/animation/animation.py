"""What an inversion found: controls over time, and how good they are frame by frame."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.interface import RigBackend

OUTSIDE_TRAINING_RANGE = "outside_training_range"
OUTSIDE_REACH = "outside_reach"
NOT_CONVERGED = "not_converged"
MISSING_VERTICES = "missing_vertices"


@dataclass(frozen=True)
class Animation:
    """Controls over time.

    Attributes:
        rig: whose controls.
        controls: `(frame, control)` in the controls' own units, within their limits.
        fps: frames a second.
        frame_numbers: `(frame,)`, whole, rising, as in the source; where some were left out they have gaps.
        motion: `(frame, 4, 4)`, the rigid motion that was removed from the meshes: a mesh in the world is
            motion @ the rig's mesh, mm. None: nothing was removed.
        source: the name of the clip.
        made_by: facts worth keeping: the bundle's fingerprint, the method, versions.
        keys: after a reduction: for each control the rows of `controls` that are keys; between keys the curve is linear.
            None: every frame is a key.

    Raises:
        InputError: the numbers do not make an animation of the rig.
    """

    rig: RigBackend
    controls: Tensor
    fps: float
    frame_numbers: Tensor
    motion: Tensor | None = None
    source: str = ""
    made_by: dict[str, Any] = field(default_factory=dict)
    keys: tuple[Tensor, ...] | None = None

    def __post_init__(self) -> None:
        frames, count = len(self.frame_numbers), len(self.rig.controls)
        if not frames:
            raise InputError(f"{self.source or 'the animation'}: no frames; a clip needs at least one")
        if self.controls.shape != (frames, count):
            raise InputError(
                f"controls of shape {tuple(self.controls.shape)} were given, {frames} frames of rig '{self.rig.name}' "
                f"need {(frames, count)}"
            )
        if not torch.isfinite(self.controls).all():
            frame, control = (int(place) for place in (~torch.isfinite(self.controls)).nonzero()[0])
            raise InputError(
                f"frame {int(self.frame_numbers[frame])}: control '{self.rig.control_names[control]}' is not a finite number"
            )
        if not 0 < self.fps < float("inf"):
            raise InputError(f"fps is {self.fps}, expected a number above 0")
        if frames > 1 and int(self.frame_numbers.diff().min()) < 1:
            raise InputError(
                f"{self.source or 'the animation'}: the frame numbers do not rise; each frame may stand there once"
            )
        if self.motion is not None and self.motion.shape != (frames, 4, 4):
            raise InputError(f"motion of shape {tuple(self.motion.shape)} was given, expected {(frames, 4, 4)}")

    def __len__(self) -> int:
        return len(self.frame_numbers)

    @property
    def seconds(self) -> Tensor:
        """The time of each frame, `(frame,)`, float64; the first is at 0."""
        return (self.frame_numbers - self.frame_numbers[0]).double() / self.fps


class SampledOptimum(NamedTuple):
    """The least error that the rig can reach, on a few frames.

    Attributes:
        rows: of the frames that were judged, `(frame,)`.
        least_mm: the least mean vertex error that a solver found for each, `(frame,)`.
    """

    rows: Tensor
    least_mm: Tensor


@dataclass(frozen=True)
class FrameErrors:
    """How far each frame's recovered mesh is off, by the true rig.

    Attributes:
        mean_mm, max_mm: `(frame,)`, over the vertices that were known.
        worst_vertex: `(frame,)`, whole: where `max_mm` is.
        worst_region: the name of the region of that vertex, for each frame; empty where nobody named any.
        flags: for each frame why to look at it: `outside_training_range`, `outside_reach`, `not_converged`,
            `missing_vertices`.
        frame_numbers: `(frame,)`, of the frames that were judged; None: those of the animation.
        neutral_mm: `(frame,)`, the mean error of the neutral mesh in place of the recovered one; None: not measured.
        reach: the least error that the rig can reach on a few frames; None: not known.
    """

    mean_mm: Tensor
    max_mm: Tensor
    worst_vertex: Tensor
    worst_region: list[str]
    flags: list[list[str]]
    frame_numbers: Tensor | None = None
    neutral_mm: Tensor | None = None
    optimum: SampledOptimum | None = None

    def summary(self) -> dict[str, float]:
        """The mean errors over all frames that are known, mm, and on those whose least error is."""
        found = {"mean_error_mm": self.mean_mm, "max_error_mm": self.max_mm, "neutral_mean_error_mm": self.neutral_mm}
        values = {key: float(errors.nanmean()) for key, errors in found.items() if errors is not None}
        values["max_error_mm"] = float(self.max_mm.nan_to_num(0.0).max())
        if self.optimum is not None:
            values["least_mean_error_mm"] = float(self.optimum.least_mm.mean())
            values["mean_error_there_mm"] = float(self.mean_mm[self.optimum.rows].mean())
        return values

    @property
    def flagged(self) -> list[int]:
        """The rows of the frames that have a flag."""
        return [row for row, flags in enumerate(self.flags) if flags]

    def worst(self, count: int) -> list[int]:
        """The rows of the `count` frames with the largest mean errors, worst first, those that nobody knows last."""
        return self.mean_mm.nan_to_num(nan=-1.0).argsort(descending=True)[:count].tolist()
