"""The actor of a clip of scans: a mesh of the rig's topology, or a scan or frames of the clip, which are wrapped."""

import torch

from riginv.clips.clip import frames_named
from riginv.clips.options import ReadingOptions
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.rig.interface import LinearRig
from riginv.tracking.actors.actor import Actor
from riginv.tracking.actors.neutral import GivenNeutral, in_rig_space, read_neutral, wrapped
from riginv.tracking.options import ActorOptions
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.scans import ScanSequence


@torch.no_grad()
def actor_of_scans(
    options: ActorOptions, reading: ReadingOptions, scans: ScanSequence, units: ClipUnits, rig: LinearRig
) -> Actor | None:
    """The actor of a clip of scans; None where the options name none.

    Raises:
        InputError: the neutral is to be solved for, cannot be read, or cannot be wrapped.
    """
    if not options.is_given:
        return None
    if options.neutral == "solve":
        raise InputError(
            "actor.neutral=solve needs meshes of the rig's topology, and the clip is fitted by its surface: give actor.neutral="
            "FILE, a scan of the actor at rest, or actor.neutral_frames"
        )
    given = read_neutral(options.neutral, rig, reading) if options.neutral else _of_frames(options, scans, units, rig)
    neutral = in_rig_space(given, rig.rest_vertices, stability_weights(rig), True)
    return Actor(neutral, neutral - rig.rest_vertices, options.scale, given.source, tuple(given.notes))


def _of_frames(options: ActorOptions, scans: ScanSequence, units: ClipUnits, rig: LinearRig) -> GivenNeutral:
    frames = list(options.neutral_frames)
    key = f"actor.neutral_frames={frames}"
    rows = frames_named(scans.path, torch.tensor(scans.frame_numbers), frames, "actor.neutral_frames").nonzero()[:, 0]
    found, notes = [], []
    for row in rows.tolist():
        cleaned = scans.cleaned(row)
        if cleaned is None:
            raise InputError(f"{key}: frame {scans.frame_numbers[row]} of {scans.path} has no scan of 50 points or more")
        vertices, note = wrapped(cleaned, units, rig, key)
        found.append(vertices)
        notes.append(note)
    text = ", ".join(str(frame) for frame in frames)
    return GivenNeutral(torch.stack(found).mean(dim=0), f"frames {text} of the clip, wrapped", notes, True)
