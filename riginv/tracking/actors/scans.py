"""The actor of a clip of scans: a mesh of the rig's topology, a scan, frames of the clip, or what is solved for."""

from collections.abc import Sequence

import torch

from riginv.clips.clip import frames_named
from riginv.clips.options import ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.errors import InputError, counted
from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig
from riginv.runs.console import show_lines
from riginv.tracking.actors.actor import Actor, solved_notes
from riginv.tracking.actors.neutral import GivenNeutral, in_rig_space, read_neutral, wrapped
from riginv.tracking.actors.scan_offset import ScanOffset, ScanOffsetSettings
from riginv.tracking.options import SOLVE, ActorOptions
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.landmark_files import LandmarkTake
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.scans import ScanSequence
from riginv.tracking.surfaces.solving import ScanSolver


@torch.no_grad()
def actor_of_scans(
    options: ActorOptions,
    reading: ReadingOptions,
    scans: ScanSequence,
    units: ClipUnits,
    rig: LinearRig,
    landmarks: LandmarkTake | None,
) -> Actor | None:
    """The actor of a clip of scans whose neutral is given; None where the options name none, or it is to be solved for.

    Args:
        landmarks: of the clip, for `neutral_frames`; None: none.

    Raises:
        InputError: the neutral cannot be read, or cannot be wrapped.
    """
    if not options.is_given or options.neutral == SOLVE:
        return None
    given = read_neutral(options, rig, reading) if options.neutral else _of_frames(options, scans, units, rig, landmarks)
    neutral = in_rig_space(given, rig.rest_vertices, stability_weights(rig), True)
    return Actor(neutral, neutral - rig.rest_vertices, options.scale, given.source, tuple(given.notes))


@torch.no_grad()
def solve_actor(
    solver: ScanSolver,
    scans: ScanSequence,
    units: ClipUnits,
    rows: Sequence[int],
    scale: float,
    landmarks: LandmarkTake | None = None,
) -> Actor:
    """The actor of a clip of scans, found together with the controls of scans spread over it.

    Args:
        solver: of the rig, or of the rig with the actor's scale.
        rows: indices of the frames in the clip; -1 for an excluded one.
        landmarks: that align the scans.

    Raises:
        InputError: no frame has a scan, or what was found is far from the rig's shape.
    """
    settings = ScanOffsetSettings()
    targets = _spread_targets(solver, scans, units, rows, settings.frames, landmarks)
    show_lines([], [f"the actor's neutral is solved for with {counted(len(targets), 'scan')} spread over the clip"])
    found = ScanOffset(solver, settings).solve(targets)
    rig = solver.rig
    given = GivenNeutral(torch.from_numpy(found), SOLVE, [])
    try:
        neutral = in_rig_space(given, rig.rest_vertices, stability_weights(rig), solver.moves)
    except InputError:
        raise InputError(
            f"{scans.path}: actor.neutral=solve finds no face near that of rig '{rig.name}': are they scans of the same part "
            f"of a person, in the unit that was read, with normals that point outwards? set reading.unit and reading.up"
        ) from None
    notes = solved_notes(settings.schedule.steps, len(targets))
    facts = {"frames": len(targets), "steps": settings.schedule.steps}
    return Actor(neutral, neutral - rig.rest_vertices, scale, SOLVE, tuple(notes), facts)


def _spread_targets(
    solver: ScanSolver,
    scans: ScanSequence,
    units: ClipUnits,
    rows: Sequence[int],
    count: int,
    landmarks: LandmarkTake | None,
) -> list[Target]:
    """The scans among `count` frames that are spread over a clip."""
    targets, axes = [], units.axes.double().numpy()
    for index in evenly(count, len(rows)).tolist():
        cleaned = scans.cleaned(rows[index])
        if cleaned is not None:
            known = None if landmarks is None else landmarks.at(rows[index])
            targets.append(solver.target(cleaned.surface(units.mm, axes), known))
    if not targets:
        raise InputError(f"{scans.path}: none of {count} frames spread over it holds a scan of 50 points or more")
    return targets


def _of_frames(
    options: ActorOptions, scans: ScanSequence, units: ClipUnits, rig: LinearRig, landmarks: LandmarkTake | None
) -> GivenNeutral:
    frames = list(options.neutral_frames)
    key = f"actor.neutral_frames={frames}"
    rows = frames_named(scans.path, torch.tensor(scans.frame_numbers), frames, "actor.neutral_frames").nonzero()[:, 0]
    found, notes = [], []
    for row in rows.tolist():
        cleaned = scans.cleaned(row)
        if cleaned is None:
            raise InputError(f"{key}: frame {scans.frame_numbers[row]} of {scans.path} has no scan of 50 points or more")
        vertices, note = wrapped(cleaned, units, rig, key, None if landmarks is None else landmarks.at(row))
        found.append(vertices)
        notes.append(note)
    text = ", ".join(str(frame) for frame in frames)
    return GivenNeutral(torch.stack(found).mean(dim=0), f"frames {text} of the clip, wrapped", notes, True)
