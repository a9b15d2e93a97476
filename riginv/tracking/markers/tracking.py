"""Inversion of a clip of markers: each frame on its own, labels and offsets, then all frames together."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.solvers.clip import smoothed, solve_clip
from riginv.solvers.every_mesh import refine_meshes, solve_frames
from riginv.tracking.markers.calibration import calibrate
from riginv.tracking.markers.labels import mend_labels
from riginv.tracking.markers.objective import FEWEST, MarkerObjective, pack
from riginv.tracking.markers.placement import Placement
from riginv.tracking.options import SolverOptions

KEY_DISTANCE, MORE_STEPS = 8, 2  # of `solve_frames`: the whole clip is solved afterwards
TOLERANCE = 3e-2  # of `solve_clip`
MORE_CLIP_STEPS, FINE_TOLERANCE = 1, 1e-3  # of it where a prior knows how controls change: further steps, and the tolerance
FLOOR, USUAL = 0.3, 10.0  # of a marker's variance: times that of the noise, and how many observations of usual size it has more
REFINE_STEPS = 10  # of each frame, after offsets or labels have changed


@dataclass(frozen=True)
class MarkerTrack:
    """The inversion of a clip of markers.

    Attributes:
        controls: `(frame, control)`, within the rig's limits.
        motion: from the rig's mesh to the markers, mm, y up, `(frame, 4, 4)`; None where it is not removed.
        placement: of the markers, with calibrated offsets.
        points: the observed markers, labels mended, `(frame, marker, 3)`; NaN in gaps.
        residual_mm: distance of each observed marker from the rig's, `(frame, marker)`; NaN in gaps.
        swapped: whether a marker carried another's label, `(frame, marker)`.
        stray: whether an observed marker was left out, `(frame, marker)`.
        known: whether a frame has enough markers to be solved, `(frame,)`.
    """

    controls: Tensor
    motion: Tensor | None
    placement: Placement
    points: Tensor
    residual_mm: Tensor
    swapped: Tensor
    stray: Tensor
    known: Tensor


def track_markers(
    objective: MarkerObjective,
    points: Tensor,
    numbers: Tensor,
    options: SolverOptions,
    noise_mm: float,
    is_smooth: bool = True,
    advance: Callable[[str, int], None] = lambda what, frames: None,
) -> MarkerTrack:
    """Controls and rigid motion of a clip.

    Args:
        points: observed markers `(frame, marker, 3)`, mm, y up; NaN in gaps.
        numbers: frame numbers `(frame,)`.
        noise_mm: standard deviation of a marker's error.
        is_smooth: whether all frames are solved together in the end, with smooth curves.
        advance: reports progress.

    Raises:
        InputError: no frame has enough markers.
    """
    packed = pack(points)
    known = torch.isfinite(packed).all(dim=1)
    if not bool(known.any()):
        raise InputError(
            f"no frame has {FEWEST} markers of the map: there is nothing to fit; does the clip have the right labels?"
        )
    advance("each frame", 0)
    solution = solve_frames(objective, packed, 1, options.steps, MORE_STEPS, rounds=0, key_distance=KEY_DISTANCE)
    advance("labels and offsets", 0)
    labelled = mend_labels(objective, points, solution.units, noise_mm, numbers)
    packed, solution.units = pack(labelled.points, labelled.weights), labelled.units
    if bool(objective.placement.calibrated.any()):
        objective = objective.at_offsets(calibrate(objective, packed, solution.units, noise_mm))
        refits = refine_meshes(objective, packed, solution.units, REFINE_STEPS)
        labelled = mend_labels(objective, points, torch.where(known[:, None], refits.units, solution.units), noise_mm, numbers)
        packed, solution.units = pack(labelled.points, labelled.weights), labelled.units
    solution.skipped = ~torch.isfinite(packed).all(dim=1)
    units = smoothed(solution, options.blur if is_smooth else 0.0, numbers)
    if is_smooth:
        advance("the whole clip", 0)
        steps, tolerance = options.clip_steps, TOLERANCE
        if objective.changes is not None:
            steps, tolerance = steps + MORE_CLIP_STEPS, FINE_TOLERANCE
            packed = _weighted_by_fit(objective, packed, solution.units, noise_mm)
        units = solve_clip(
            objective, packed, units, options.smoothness, steps, tolerance=tolerance, numbers=numbers, changes=objective.changes
        )
    seen = objective.residuals(units, pack(labelled.points).nan_to_num(0.0))
    used = objective.residuals(units, packed.nan_to_num(0.0))
    return MarkerTrack(
        objective.all_controls(units),
        _matrices(*used.motion) if objective.moves else None,
        objective.placement,
        labelled.points,
        torch.where(seen.weights > 0, seen.residual.norm(dim=2), torch.nan),
        labelled.swapped,
        labelled.stray,
        ~solution.skipped,
    )


def _weighted_by_fit(objective: MarkerObjective, packed: Tensor, units: Tensor, noise_mm: float) -> Tensor:
    """The clip with smaller weights of markers that the rig follows worse than others, such as those on lids."""
    found = objective.residuals(units, packed.nan_to_num(0.0))
    squared, observed = (found.weights * found.residual.square().sum(dim=2)).sum(dim=0) / 3, found.weights.sum(dim=0)
    usual = squared.sum() / observed.sum()
    variance = (squared + USUAL * usual) / (observed + USUAL) + FLOOR * noise_mm**2
    factor = variance**-0.5  # the root of what independent errors would have: those of one marker are alike in many frames
    count = len(factor)
    return torch.cat([packed[:, : 3 * count], packed[:, 3 * count :] * factor / factor.mean()], dim=1)


def _matrices(rotation: Tensor, translation: Tensor) -> Tensor:
    """Rotations and translations as `(frame, 4, 4)`."""
    result = torch.eye(4).to(rotation).repeat(len(rotation), 1, 1)
    result[:, :3, :3], result[:, :3, 3] = rotation, translation
    return result
