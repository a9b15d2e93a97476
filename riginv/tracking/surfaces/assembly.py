"""The parts of an inversion of scans, built from its options."""

from dataclasses import dataclass, fields, replace

import numpy as np
import torch

from riginv.clips.clip import excluded_frames, frames_between
from riginv.clips.description import ClipDescription, describe_points, missing_frames, span_of
from riginv.clips.motion_check import ClipMotion
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.tracking.actors.actor import Actor, ActorRig
from riginv.tracking.actors.scans import actor_of_scans, solve_actor
from riginv.tracking.options import SOLVE, ControlOptions, TrackingOptions
from riginv.tracking.priors.files import prior_or_default
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.clip import ScanSmoothness
from riginv.tracking.surfaces.first_look import checked_units
from riginv.tracking.surfaces.landmark_files import LandmarkTake, read_landmarks
from riginv.tracking.surfaces.scan_files import open_scans
from riginv.tracking.surfaces.scans import ScanSequence
from riginv.tracking.surfaces.solving import ScanSettings, ScanSolver
from riginv.tracking.surfaces.units import resolve_scan_units


@dataclass(frozen=True)
class ScanParts:
    """The parts of an inversion of scans.

    Attributes:
        scans: the clip.
        units: of the clip.
        solver: of its frames.
        rows: index of each frame in the clip, -1 for an excluded one.
        frame_numbers: `(frame,)`, as in the source.
        smoothness: of the curves; None: each frame on its own.
        actor: whose neutral takes the place of the rig's; None: the actor's face at rest is the rig's.
        landmarks: of the scans; None: none.
        notes: what was guessed.
    """

    scans: ScanSequence
    units: ClipUnits
    solver: ScanSolver
    rows: list[int]
    frame_numbers: torch.Tensor
    smoothness: ScanSmoothness | None
    actor: Actor | None
    landmarks: LandmarkTake | None
    notes: list[str]

    def describe(self) -> ClipDescription:
        """The description of the clip; its size is that of the first scan."""
        numbers, size, points = self.frame_numbers.numpy(), (0.0, 0.0, 0.0), 0
        for row in self.rows:
            cleaned = self.scans.cleaned(row)
            if cleaned is not None:
                upright = self.units.mm * cleaned.points @ self.units.axes.numpy().T
                size, points = tuple(np.ptp(upright, axis=0).tolist()), len(cleaned.points)
                break
        scans, motion = self.scans, ClipMotion(1, len(numbers), 0, size, 0.0, 0.0, ())
        spans = span_of(numbers), span_of(scans.frame_numbers), missing_frames(numbers), self.rows.count(-1)
        return describe_points(scans.path, scans.facts, points, *spans, self.units, motion, self.notes)


def build_scan_parts(
    path: str, options: TrackingOptions, rig: LinearRig, reading: ReadingOptions, frames: FrameOptions
) -> ScanParts:
    """Open a clip of scans, and build its solver.

    Raises:
        InputError: an option is not supported for scans, or the clip cannot be read.
    """
    _check(options)
    scans = open_scans(path, rig, reading)
    units = resolve_scan_units(scans, rig, reading)
    inside = frames_between(scans.path, scans.frame_numbers, frames.first, frames.last)
    kept = torch.tensor(scans.frame_numbers[inside])
    excluded = excluded_frames(scans.path, kept, frames.exclude)
    rows = [-1 if is_excluded else int(row) for row, is_excluded in zip(inside.nonzero()[0], excluded.tolist())]
    scans.check([row for row in rows if row >= 0])
    prior, note = prior_or_default(options.prior, rig)
    settings = ScanSettings(noise_mm=options.noise_of_measurements_mm)
    solver = ScanSolver(rig, prior, settings, options.motion != "keep", stability_weights(rig).cpu().numpy())
    units = checked_units(scans, units, reading, solver)
    landmarks, landmark_notes = read_landmarks(options.landmarks, rig, reading, scans, units)
    actor = actor_of_scans(options.actor, reading, scans, units, rig, landmarks)
    if options.actor.neutral == SOLVE:
        none = Actor(rig.rest_vertices, torch.zeros_like(rig.rest_vertices), options.actor.scale, "")
        actor = solve_actor(replace(solver, rig=ActorRig(rig, none)), scans, units, rows, options.actor.scale, landmarks)
    notes = [*scans.facts.notes, *units.notes, *landmark_notes, note]
    if actor is not None:
        notes += [*actor.notes, f"the actor is {actor.sentence}"]
        solver = replace(solver, rig=ActorRig(rig, actor))
    smoothness = ScanSmoothness() if options.method in (None, "clip") else None
    return ScanParts(scans, units, solver, rows, kept, smoothness, actor, landmarks, notes)


def _check(options: TrackingOptions) -> None:
    """Raise InputError for options that are not supported for scans."""
    options.refuse_options_of_meshes("scans")
    default = ControlOptions()
    for field in fields(ControlOptions):
        value, usual = getattr(options.controls, field.name), getattr(default, field.name)
        value = tuple(value) if isinstance(value, list) else value
        if (value or usual) and value != usual and not field.name.endswith("_mm2") and field.name != "unknown":
            raise InputError(f"controls.{field.name} is not for correspondence=surface yet: leave it out")
