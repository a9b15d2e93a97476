"""Inversion of a clip of scans: each frame from the one before, then all together; one scan is in memory at a time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.tracking.markers.placement import Placement
from riginv.tracking.surfaces.clip import ScanSmoothness, cached_scans, nearest_known, smooth_scans
from riginv.tracking.surfaces.landmark_files import LandmarkTake
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.scans import ScanSequence
from riginv.tracking.surfaces.solving import ScanSolver, SolvedScan
from riginv.tracking.surfaces.uncertainty import Uncertainty, open_controls, uncertainty

AMBIGUOUS, NO_SCAN, FAR_LANDMARKS = "ambiguous", "no_scan", "far_landmarks"
FAR_MM = 10.0  # distance of a landmark from the rig's above which a frame is flagged
SAMPLED_FRAMES = 24  # at which the undetermined controls are searched


@dataclass(frozen=True)
class ScanTrack:
    """The inversion of a clip of scans.

    Attributes:
        controls: `(frame, control)`, within the rig's limits.
        motion: from the rig's mesh to the scans, mm, y up, `(frame, 4, 4)`.
        scan_mm, rig_mm: mean distance of each scan's explained points from the rig, and of the rig's seen skin from the scan,
            `(frame,)`; NaN where there is no scan.
        seen: the fraction of the rig's skin that each scan covers, `(frame,)`.
        explained: the fraction of each scan's points that the rig explains, `(frame,)`.
        flags: of each frame: `lost`, `unexplained`, `little_seen`, `far_landmarks`, `ambiguous`, `no_scan`.
        open_controls: the names of controls that the scans do not determine: they stay where the prior has them.
        notes: sentences for the user.
        landmarks: of the scans; None: none.
        landmark_mm: their distances from the rig's, `(frame, landmark)`, NaN where unknown.
    """

    controls: Tensor
    motion: Tensor
    scan_mm: Tensor
    rig_mm: Tensor
    seen: Tensor
    explained: Tensor
    flags: list[list[str]]
    open_controls: list[str]
    notes: list[str]
    landmarks: Placement | None
    landmark_mm: Tensor


def track_scans(
    solver: ScanSolver,
    scans: ScanSequence,
    units: ClipUnits,
    frames: Sequence[int],
    smoothness: ScanSmoothness | None = None,
    advance: Callable[[str, int], None] = lambda what, frames: None,
    landmarks: LandmarkTake | None = None,
) -> ScanTrack:
    """Controls and rigid motion of some frames of a clip.

    Args:
        units: of the scans.
        frames: indices of the frames to solve, in order; -1 for an excluded one.
        smoothness: of the curves; None: each frame on its own.
        advance: reports progress.
        landmarks: of the scans; None: none.

    Raises:
        InputError: no frame has a scan, or none can be brought onto the rig.
    """

    def read(row: int) -> Target | None:
        cleaned = scans.cleaned(frames[row])
        if cleaned is None:
            return None
        known = None if landmarks is None else landmarks.at(frames[row])
        return solver.target(cleaned.surface(units.mm, units.axes.double().numpy()), known)

    load, is_smooth = cached_scans(read), smoothness is not None and len(frames) > 2
    solutions: list[SolvedScan | None] = []
    for row in range(len(frames)):
        target, before = load(row), next((solution for solution in reversed(solutions[-3:]) if solution is not None), None)
        solution = None if target is None else solver.solve(target, before)
        solutions.append(solution if is_smooth or target is None or solution is None else solver.finished(target, solution))
        advance("each frame", 1)
    has_scan = [solution is not None for solution in solutions]
    _check(scans, [solution for solution in solutions if solution is not None], solver, units)
    if smoothness is not None and is_smooth:
        solved = smooth_scans(solver, load, solutions, smoothness, lambda done: advance("the whole clip", done))
    else:
        solved = nearest_known(solutions)
    uncertainties: dict[int, Uncertainty] = {}
    for row in np.unique(np.linspace(0, len(solved) - 1, SAMPLED_FRAMES).astype(int)).tolist():
        if (target := load(row)) is not None:
            uncertainties[row] = uncertainty(solver, target, solved[row])
    landmark_mm = torch.zeros(len(frames), 0)
    if landmarks is not None:
        landmark_mm = landmark_distances(
            landmarks, solver, solved, [row if seen else -1 for row, seen in zip(frames, has_scan)]
        )
    placement = None if landmarks is None else landmarks.placement
    return _result(solver, solved, has_scan, uncertainties, units, placement, landmark_mm)


def landmark_distances(
    landmarks: LandmarkTake, solver: ScanSolver, solved: Sequence[SolvedScan], frames: Sequence[int]
) -> Tensor:
    """Distances of the landmarks of some frames from the rig's, `(frame, landmark)`, mm; NaN where unknown, or of frame -1."""
    fit, found = solver.fit_of(1.0), []
    for index, each in zip(frames, solved):
        vertices = solver.surface.vertices(fit.coefficients(each.state.units))
        distance = torch.from_numpy(landmarks.distances(index, vertices, each.state.motion)).float()
        found.append(distance if index >= 0 else torch.full_like(distance, torch.nan))
    return torch.stack(found)


def _check(scans: ScanSequence, solutions: list[SolvedScan], solver: ScanSolver, units: ClipUnits) -> None:
    if not solutions:
        raise InputError(f"{scans.path}: no frame holds a scan of 50 points or more: there is nothing to fit")
    if all("lost" in solver.flags(solution) for solution in solutions):
        distance = min(solution.quality.explained for solution in solutions)
        raise InputError(
            f"{scans.path}: none of its scans ({len(solutions)}) can be brought onto rig '{solver.rig.name}' (at most "
            f"{distance:.0%} of a scan's points come near it): is it a scan of this rig's actor, in units of {units.mm:g} mm, "
            f"with {units.up} up and normals that point outwards? set reading.unit and reading.up"
        )


def _notes_on_rotation(ups: np.ndarray, assumed: str, rotated: int) -> list[str]:
    """Sentences about scans that are not upright as they were read.

    Args:
        ups: the direction up of the rig in each scan, along the file's axes, `(scan, 3)`.
        assumed: the up axis that they were read with.
        rotated: the number of scans that were rotated by right angles to fit.
    """
    mean = ups.mean(axis=0)
    axis = "xyz"[int(np.abs(mean).argmax())]
    notes = [f"{rotated} of the scans were rotated by right angles to fit; each starts from the one before"] * (rotated > 0)
    if axis != assumed and mean.max() > -mean.min():
        notes.append(f"the scans have {axis} up, and were read with {assumed} up: reading.up={axis} reads them upright")
    return notes


def _result(
    solver: ScanSolver,
    solutions: list[SolvedScan],
    has_scan: list[bool],
    uncertainties: dict[int, Uncertainty],
    units: ClipUnits,
    landmarks: Placement | None,
    landmark_mm: Tensor,
) -> ScanTrack:
    fit, settings = solver.fit_of(1.0), solver.settings
    rows = np.array(sorted(uncertainties))
    flags: list[list[str]] = []
    for row, (solution, scanned) in enumerate(zip(solutions, has_scan)):
        near = uncertainties[int(rows[np.abs(rows - row).argmin()])]
        far = [FAR_LANDMARKS] if bool((landmark_mm[row] > FAR_MM).any()) else []
        ambiguous = [AMBIGUOUS] if near.skin_mm > settings.ambiguous_mm else []
        flags.append([*solver.flags(solution), *far, *ambiguous] if scanned else [NO_SCAN])
    ups = [solution.state.motion.rotation[:, 1] for solution, scanned in zip(solutions, has_scan) if scanned]
    notes = _notes_on_rotation(
        np.array(ups) @ units.axes.double().numpy(), units.up, sum(solution.turned for solution in solutions)
    )
    values = [solution.quality[1:5] if scanned else [torch.nan] * 4 for solution, scanned in zip(solutions, has_scan)]
    scan_mm, rig_mm, seen, explained = torch.tensor(values).float().T
    return ScanTrack(
        torch.stack([fit.controls(solution.state.units) for solution in solutions]),
        torch.stack([torch.from_numpy(solution.state.motion.matrix).float() for solution in solutions]),
        scan_mm,
        rig_mm,
        seen,
        explained,
        flags,
        open_controls(solver, list(uncertainties.values())),
        notes,
        landmarks,
        landmark_mm,
    )
