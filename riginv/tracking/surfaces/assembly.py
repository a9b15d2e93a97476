"""The parts of an inversion of scans, built from its options."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch

from riginv.clips.clip import excluded_frames
from riginv.clips.description import ClipDescription, FrameSpan
from riginv.clips.motion_check import ClipMotion
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.tracking.actors.actor import Actor, ActorRig
from riginv.tracking.actors.scans import actor_of_scans
from riginv.tracking.options import ControlOptions, TrackingOptions
from riginv.tracking.priors.files import load_prior
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import ControlPrior
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.clip import ScanSmoothness
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
        notes: what was guessed.
    """

    scans: ScanSequence
    units: ClipUnits
    solver: ScanSolver
    rows: list[int]
    frame_numbers: torch.Tensor
    smoothness: ScanSmoothness | None
    actor: Actor | None
    notes: list[str]

    def describe(self) -> ClipDescription:
        """What was read of the clip; its size is that of the first scan."""
        numbers, size, points = self.frame_numbers.numpy(), (0.0, 0.0, 0.0), 0
        for row in (row for row in self.rows if row >= 0):
            scan = self.scans.scan(row)
            cleaned = None if scan is None else scan.cleaned()
            if cleaned is not None:
                upright = self.units.mm * cleaned.points @ self.units.axes.numpy().T
                size, points = tuple(np.ptp(upright, axis=0).tolist()), len(cleaned.points)
                break
        steps = np.diff(numbers)
        return ClipDescription(
            file=Path(self.scans.path).name or self.scans.path,
            facts=self.scans.facts,
            vertices=points,
            faces=0,
            frames=FrameSpan(int(numbers[0]), int(numbers[-1]), len(numbers)),
            all_frames=FrameSpan(
                int(self.scans.frame_numbers[0]), int(self.scans.frame_numbers[-1]), len(self.scans.frame_numbers)
            ),
            missing=int((steps // steps.min() - 1).sum()) if len(steps) else 0,
            missing_first=(),
            excluded=self.rows.count(-1),
            fps=self.units.fps,
            rate_source=self.units.rate_source,
            unit_mm=self.units.mm,
            unit_source=self.units.unit_source,
            up=self.units.up,
            up_source=self.units.up_source,
            motion=ClipMotion(1, len(numbers), 0, size, 0.0, 0.0, ()),
            notes=tuple(self.notes),
        )


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
    prior, note = _prior(options.prior, rig)
    numbers = scans.frame_numbers
    first = numbers[0] if frames.first is None else frames.first
    last = numbers[-1] if frames.last is None else frames.last
    inside = (numbers >= first) & (numbers <= last)
    if not inside.any():
        raise InputError(f"{scans.path}: frames {first} to {last} were asked for, it has {numbers[0]} to {numbers[-1]}")
    kept = torch.tensor(numbers[inside])
    excluded = excluded_frames(scans.path, kept, frames.exclude)
    rows = [-1 if is_excluded else int(row) for row, is_excluded in zip(inside.nonzero()[0], excluded.tolist())]
    settings = ScanSettings(noise_mm=options.noise_of_measurements_mm)
    actor = actor_of_scans(options.actor, reading, scans, units, rig)
    fitted = rig if actor is None else ActorRig(rig, actor)
    notes = [*scans.facts.notes, *units.notes, note]
    if actor is not None:
        notes += [*actor.notes, f"the actor is {actor.sentence}"]
    solver = ScanSolver(fitted, prior, settings, options.motion != "keep", stability_weights(rig).cpu().numpy())
    smoothness = ScanSmoothness() if options.method in (None, "clip") else None
    return ScanParts(scans, units, solver, rows, kept, smoothness, actor, notes)


def _check(options: TrackingOptions) -> None:
    """Raise InputError for options that are not supported for scans."""
    if options.method not in (None, "clip", "levenberg_marquardt"):
        raise InputError(f"method={options.method} is not for scans: leave it out, or method=levenberg_marquardt")
    default = ControlOptions()
    for field in fields(ControlOptions):
        value, usual = getattr(options.controls, field.name), getattr(default, field.name)
        value = tuple(value) if isinstance(value, list) else value
        if (value or usual) and value != usual and not field.name.endswith("_mm2") and field.name != "unknown":
            raise InputError(f"controls.{field.name} is not for correspondence=surface yet: leave it out")


def _prior(path: str | None, rig: LinearRig) -> tuple[ControlPrior, str]:
    """The prior in a folder or the rig's default one, and a note."""
    if path is not None:
        prior = load_prior(Path(path), rig)
        return prior, f"prior of {path}: {prior.source}"
    return default_prior(rig), "no prior=FILE was given: performances that riginv makes up say which controls go together"
