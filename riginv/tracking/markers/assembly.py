"""The parts of an inversion of markers, built from its options."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from riginv.clips.clip import excluded_frames, frames_between
from riginv.clips.description import ClipDescription, FrameSpan, describe_points, missing_frames, span_of
from riginv.clips.markers import MarkerClip, open_markers
from riginv.clips.motion_check import ClipMotion
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.units import DEFAULT_FPS, GUESSED, TO_Y_UP, UP_ASSUMED, ClipUnits, SizeLimits, rms_size, units_from_size
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.tracking.constraints import ControlConstraints, resolve_constraints
from riginv.tracking.markers.layout import unmarkable_controls
from riginv.tracking.markers.map_file import matched, read_map
from riginv.tracking.markers.objective import MarkerObjective, MarkerRig
from riginv.tracking.markers.placement import Placement
from riginv.tracking.options import SolverOptions, TrackingOptions
from riginv.tracking.priors.files import prior_or_default
from riginv.tracking.priors.prior import ControlPrior, independent_measurements
from riginv.tracking.priors.takes import row_rate
from riginv.tracking.rigid import fit_rigid
from riginv.tracking.stability import has_root_controls

IN_SEQUENCE = 0.67  # of the weight of the prior, as a standard deviation: tuned, see docs/experiments.md#markers
KNOWN_CHANGES, REGRESSION = 0.6, 0.8  # the same where takes tell how controls change; of what visible controls say about others
MISFIT_MM = 0.3  # how far exact markers lie off the rig, by what it cannot make
LIMITS = SizeLimits(("mm", "cm", "m"), 3.0, 3.0)  # wide enough for another pose


@dataclass(frozen=True)
class MarkerParts:
    """The parts of an inversion of markers.

    Attributes:
        clip: the markers that the map has, in the file's unit, and the requested frames.
        points: these in mm, y up, `(frame, marker, 3)`; NaN in gaps and in excluded frames.
        units: of the clip.
        objective: of the solvers.
        all_frames: of the file.
        excluded: number of excluded frames.
        notes: what was guessed.
    """

    clip: MarkerClip
    points: Tensor
    units: ClipUnits
    objective: MarkerObjective
    all_frames: FrameSpan
    excluded: int
    notes: list[str]

    def describe(self) -> ClipDescription:
        clip, numbers = self.clip, self.clip.frame_numbers
        flat = self.points[torch.isfinite(self.points).all(dim=2).sum(dim=1).argmax()].numpy()
        size = np.nan_to_num(np.nanmax(flat, axis=0) - np.nanmin(flat, axis=0))
        motion = ClipMotion(len(numbers), len(numbers), 0, tuple(size.tolist()), 0.0, 0.0, ())
        spans = span_of(numbers), self.all_frames, missing_frames(numbers), self.excluded
        return describe_points(clip.path, clip.facts, len(clip.names), *spans, self.units, motion, self.notes)


def build_marker_parts(
    path: str, options: TrackingOptions, rig: LinearRig, reading: ReadingOptions, frames: FrameOptions
) -> MarkerParts:
    """Read a clip of markers and its map, and build the objective.

    Raises:
        InputError: an option is not supported for markers, a file cannot be read, or the names do not match.
    """
    if options.markers is None:
        raise InputError(
            "correspondence=markers needs markers=FILE.yaml, the places of the markers (riginv.markers proposes it)"
        )
    constraints = resolve_constraints(rig, options.controls)
    _check(options, constraints)
    whole = open_markers(path)
    clip, placement, notes = matched(whole, read_map(Path(options.markers), rig), options.markers, reading)
    clip, excluded = chosen_frames(clip, frames)
    units = marker_units(clip, placement, rig, reading)
    points = in_millimetres(clip.points, units)
    points[excluded] = torch.nan
    prior, note = prior_or_default(options.prior, rig)
    prior = marker_prior(rig, prior, options.noise_of_measurements_mm)
    rate = row_rate(units.fps, torch.tensor(clip.frame_numbers))
    objective = build_objective(rig, placement, constraints, prior, options.motion != "keep", options, rate)
    if options.motion == "auto" and has_root_controls(objective.rig):
        objective.moves = False
        notes.append(f"rigid motion is left to the controls of rig '{rig.name}' that move all of it (motion=remove removes it)")
    numbers = whole.frame_numbers
    span = span_of(numbers)
    notes = [*clip.facts.notes, *units.notes, *notes, note]
    return MarkerParts(clip, points, units, objective, span, int(excluded.sum()), notes)


def marker_prior(rig: LinearRig, prior: ControlPrior, noise_mm: float) -> ControlPrior:
    """The prior of a frame in a clip of markers, to be weighted by their noise.

    Neighbouring frames have the prior in common: it is weaker in each. Exact markers still lie off the rig by what it cannot
    make, and that must not turn the gaze: what markers do not see is not weighted by less than `MISFIT_MM`.
    """
    unmarkable = unmarkable_controls(rig, prior.mean)
    weight, regression = (IN_SEQUENCE, 1.0) if prior.changes is None else (KNOWN_CHANGES, REGRESSION)
    return prior.rescaled(unmarkable, weight**-2, (noise_mm / max(noise_mm, MISFIT_MM)) ** 2, regression)


def build_objective(
    rig: LinearRig,
    placement: Placement,
    constraints: ControlConstraints,
    prior: ControlPrior,
    moves: bool,
    options: TrackingOptions,
    fps: float = DEFAULT_FPS,
) -> MarkerObjective:
    """The objective of markers, with the prior weighted for their number and noise.

    Args:
        fps: frames of the clip in a second, for a prior that knows how controls change.
    """
    free = constraints.free.nonzero()[:, 0]
    measurements = independent_measurements(placement.points(rig.rest_vertices).cpu())
    prior, noise_mm = prior.subset(free.cpu()), options.noise_of_measurements_mm
    solver, penalties = options.solver, constraints.penalties_of_free()
    marker_rig, learned = MarkerRig(rig, free, constraints.values, placement), prior.weighed(noise_mm, measurements)
    objective = MarkerObjective(marker_rig, placement, moves, solver.prior, solver.sparsity, penalties, learned)
    objective.changes = prior.changes_at(fps, noise_mm, measurements, SolverOptions().smoothness)
    return objective


def _check(options: TrackingOptions, constraints: ControlConstraints) -> None:
    """Raise InputError for options that are not supported for markers."""
    options.refuse_options_of_meshes("markers")
    if bool(constraints.static.any()):
        raise InputError("controls.static is not for correspondence=markers yet: leave it out")


def chosen_frames(clip: MarkerClip, frames: FrameOptions) -> tuple[MarkerClip, Tensor]:
    """The requested frames, and a mask of those that are excluded, `(frame,)`.

    Raises:
        InputError: there are none.
    """
    numbers = clip.frame_numbers
    inside = frames_between(clip.path, numbers, frames.first, frames.last)
    kept = clip.select(clip.names, clip.points[inside], numbers[inside])
    return kept, excluded_frames(clip.path, torch.tensor(kept.frame_numbers), frames.exclude)


def in_millimetres(points: np.ndarray, units: ClipUnits) -> Tensor:
    """Points `(frame, marker, 3)` of a file in mm, y up."""
    return units.mm * torch.from_numpy(points) @ units.axes.T


def marker_units(clip: MarkerClip, placement: Placement, rig: LinearRig, reading: ReadingOptions) -> ClipUnits:
    """The units of markers: guessed from their size beside the rig's markers at rest, and the up axis from their pose.

    Raises:
        InputError: no frame has half of the markers, or they are absurdly small or large.
    """
    known = np.isfinite(clip.points).all(axis=2)
    row = int(known.sum(axis=1).argmax())
    there = known[row]
    if there.sum() < max(3, len(there) / 2):
        raise InputError(f"{clip.path}: no frame has more than {there.sum()} of {len(there)} markers: there is nothing to fit")
    rest = placement.points(rig.rest_vertices).cpu()[there]
    seen = torch.from_numpy(clip.points[row][there])
    units = units_from_size(clip, rms_size(seen.numpy()), rms_size(rest.numpy()), rig.name, reading, LIMITS)
    if reading.up != "auto" or clip.up is not None:
        return units
    upright = fit_rigid(rest[None], units.mm * seen[None], torch.ones(len(rest)))[0, :3, 1]  # where the rig's y axis points
    up = "xyz"[int(upright.argmax())]
    notes = [note for note in units.notes if not note.startswith(UP_ASSUMED)]
    notes.append(f"up axis {up} guessed: with it the markers fit the rig's markers at rest (set it with reading.up={up})")
    return units._replace(axes=TO_Y_UP[up], up=up, up_source=GUESSED, notes=notes)


def frame_units(clip: MarkerClip, anchors: Placement | None, rig: LinearRig, reading: ReadingOptions) -> ClipUnits:
    """The units of a clip of one frame, from the size of some markers whose places are known, or from that of the rig."""
    points, rest = torch.from_numpy(clip.points[0]), rig.rest_vertices.cpu()
    if anchors is not None:
        points, rest = points[[clip.names.index(name) for name in anchors.names]], anchors.points(rest)
    return units_from_size(clip, rms_size(points.numpy()), rms_size(rest.numpy()), rig.name, reading, LIMITS)
