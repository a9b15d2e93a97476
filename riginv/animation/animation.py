"""The result of an inversion: controls over time, and the errors of each frame."""

from collections.abc import Mapping
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
        rig: has the controls.
        controls: `(frame, control)` in the controls' units, within their limits.
        fps: frames per second.
        frame_numbers: integers `(frame,)`, rising, as in the source; omitted frames leave gaps.
        motion: rigid motion removed from the meshes, `(frame, 4, 4)`: a mesh in the world is motion @ the rig's mesh, mm.
            None: nothing was removed.
        source: name of the clip.
        made_by: provenance: fingerprint of the bundle, method, versions.
        keys: after key reduction: for each control the rows of `controls` that are keys; the curve is linear in between.
            None: every frame is a key.

    Raises:
        InputError: shapes or values do not fit the rig.
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
            frame, control = (int(index) for index in (~torch.isfinite(self.controls)).nonzero()[0])
            raise InputError(
                f"frame {int(self.frame_numbers[frame])}: control '{self.rig.control_names[control]}' is not a finite number"
            )
        if not 0 < self.fps < float("inf"):
            raise InputError(f"fps is {self.fps}, expected a number above 0")
        if frames > 1 and int(self.frame_numbers.diff().min()) < 1:
            raise InputError(f"{self.source or 'the animation'}: the frame numbers do not rise; each frame may occur once")
        if self.motion is not None and self.motion.shape != (frames, 4, 4):
            raise InputError(f"motion of shape {tuple(self.motion.shape)} was given, expected {(frames, 4, 4)}")

    def __len__(self) -> int:
        return len(self.frame_numbers)

    @property
    def seconds(self) -> Tensor:
        """The time of each frame, `(frame,)`, float64; the first is at 0."""
        return (self.frame_numbers - self.frame_numbers[0]).double() / self.fps


class SampledOptimum(NamedTuple):
    """The lowest errors that the rig can reach on a few frames.

    Attributes:
        rows: of the evaluated frames, `(frame,)`.
        least_mm: lowest mean vertex error that a solver reached, `(frame,)`.
        is_bound: whether it is only an upper bound, from few steps in a basis fitted to the true rig.
    """

    rows: Tensor
    least_mm: Tensor
    is_bound: bool = False


class MarkerErrors(NamedTuple):
    """The residuals of one marker over a clip.

    Attributes:
        name: of the marker.
        seen: the fraction of the frames in which it was observed.
        mean_mm, p95_mm, max_mm: distance from the rig's marker, where it was used; NaN where it never was.
        offset_mm: along the normal of the rig's surface.
        swapped, stray: number of frames in which it carried another's label, and in which it was left out.
    """

    name: str
    seen: float
    mean_mm: float
    p95_mm: float
    max_mm: float
    offset_mm: float
    swapped: int
    stray: int


@dataclass(frozen=True)
class FrameErrors:
    """Vertex errors of each frame, measured with the true rig.

    Attributes:
        mean_mm, max_mm: `(frame,)`, over known vertices.
        worst_vertex: index of the vertex of `max_mm`, `(frame,)`.
        worst_region: region name of that vertex, for each frame; empty if there is none.
        flags: of each frame: `outside_training_range`, `outside_reach`, `not_converged`,
            `missing_vertices`.
        frame_numbers: of the evaluated frames, `(frame,)`; None: those of the animation.
        neutral_mm: mean error of the neutral mesh, `(frame,)`; None: not measured.
        optimum: lowest errors on a few frames; None: not known.
        markers: the residuals of each marker, where the clip is one of markers.
        controls: the accuracy of the controls, by the names of metrics.json; empty where the true ones are not known.
    """

    mean_mm: Tensor
    max_mm: Tensor
    worst_vertex: Tensor
    worst_region: list[str]
    flags: list[list[str]]
    frame_numbers: Tensor | None = None
    neutral_mm: Tensor | None = None
    optimum: SampledOptimum | None = None
    markers: tuple[MarkerErrors, ...] = ()
    controls: Mapping[str, Any] = field(default_factory=dict)

    def summary(self) -> dict[str, float]:
        """Mean errors, mm, over all known frames, and over those with a known optimum."""
        found = {"mean_error_mm": self.mean_mm, "max_error_mm": self.max_mm, "neutral_mean_error_mm": self.neutral_mm}
        values = {key: float(errors.nanmean()) for key, errors in found.items() if errors is not None}
        values["max_error_mm"] = float(self.max_mm.nan_to_num(0.0).max())
        if self.optimum is not None:
            values["least_mean_error_mm"] = float(self.optimum.least_mm.mean())
            values["mean_error_there_mm"] = float(self.mean_mm[self.optimum.rows].mean())
            values |= {"least_error_is_bound": 1.0} if self.optimum.is_bound else {}
        return values

    @property
    def flagged(self) -> list[int]:
        """Rows of flagged frames."""
        return [row for row, flags in enumerate(self.flags) if flags]

    def worst(self, count: int) -> list[int]:
        """Rows of the `count` frames with the largest mean errors, worst first, unknown ones last."""
        return self.mean_mm.nan_to_num(nan=-1.0).argsort(descending=True)[:count].tolist()
