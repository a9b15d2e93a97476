"""The folder of an inversion: curves in every requested format, and views of the result."""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from riginv.animation.animation import Animation, FrameErrors
from riginv.animation.formats import write_formats
from riginv.animation.reduction import reduced
from riginv.animation.resampling import resampled
from riginv.clips.clip import Clip
from riginv.clips.description import ClipDescription, describe
from riginv.clips.description_text import in_short, rows
from riginv.geometry.kinematics import remove_motion
from riginv.rig.interface import LinearRig
from riginv.runs.tables import control_lines
from riginv.runs.threads import workers
from riginv.tracking.actors.actor import Actor
from riginv.tracking.actors.files import write_actor
from riginv.tracking.options import AfterOptions, LookOptions
from riginv.tracking.run import Advance
from riginv.tracking.viewer.page import ClipSource, Targets, write_viewer
from riginv.tracking.viewer.scans import Scans
from riginv.tracking.viewer.sheet import write_sheet
from riginv.tracking.viewer.tensorboard import write_tensorboard

PAGE, SHEET = "look.html", "frames.png"


def write_curves(
    folder: Path,
    animation: Animation,
    errors: FrameErrors | Callable[[], FrameErrors],
    clip: ClipDescription,
    formats: Sequence[str],
    after: AfterOptions,
    advance: Advance,
) -> tuple[list[str], list[str]]:
    """Write the curves into a folder.

    Args:
        errors: as for `write_formats`.
        clip: what was read of the clip.
        formats: names of formats beside csv.
        after: resampling and key reduction.
        advance: reports progress.

    Returns:
        names of the files, and notes for the user.
    """
    notes: list[str] = []
    curves = resampled(animation, after.fps) if after.fps else animation
    if after.keys_mm:
        advance("keys", 0)
        reduction = reduced(curves, after.keys_mm)
        curves = reduction.animation
        notes.append(
            f"{reduction.keys:,} of {reduction.keys_before:,} keys are kept; they move no vertex by more than "
            f"{reduction.worst_mm:.3g} mm from where a key at every frame has it"
        )
    advance("curves", 0)
    paths = write_formats(folder, curves, errors, formats, after.swap_mouth, clip.as_json())
    return [path.name for path in paths], notes


def write_views(
    folder: Path,
    clip: Clip,
    animation: Animation,
    errors: FrameErrors,
    look: LookOptions,
    advance: Advance,
    actor: Actor | None = None,
) -> tuple[list[str], list[str]]:
    """Write the actor, the page, the contact sheet and TensorBoard events into a folder; returns as `write_curves`.

    Args:
        animation: of a rig with the actor's neutral, if there is an actor.
    """
    names = [] if actor is None else write_actor(folder, actor, animation.rig.faces, look.sheet)
    source = source_of(describe(clip))
    facts = [*source.rows, *([("actor", actor.sentence)] if actor else [])]
    source = source._replace(rows=facts, notes=(*source.notes, *control_lines(errors.controls)))
    views, notes = write_look(folder, animation, errors, look, source, _targets(clip, animation), advance)
    return [*names, *views], notes


def source_of(clip: ClipDescription) -> ClipSource:
    """What the page says of a clip."""
    return ClipSource(in_short(clip), rows(clip, None), clip.warnings, clip.notes)


def write_look(
    folder: Path,
    animation: Animation,
    errors: FrameErrors,
    look: LookOptions,
    source: ClipSource,
    targets: Targets,
    advance: Advance,
    scans: Scans | None = None,
) -> tuple[list[str], list[str]]:
    """Write the page, the contact sheet and TensorBoard events into a folder; returns as `write_curves`.

    Args:
        source, targets, scans: as for `write_viewer`.
    """
    tasks: dict[str, Callable[[], Any]] = {}
    if look.page:
        tasks[PAGE] = partial(write_viewer, folder / PAGE, animation, errors, targets, clip=source, scans=scans)
    if look.sheet:
        tasks[SHEET] = partial(write_sheet, folder / SHEET, animation, errors, targets, scans)
    if tasks:
        advance("page", 0)
    is_safe = scans is None and isinstance(animation.rig, LinearRig)  # other rigs and scans are read by one thread at a time
    written = dict(zip(tasks, workers().run(list(tasks.values())) if is_safe else [task() for task in tasks.values()]))
    notes = [f"{PAGE}: {written[PAGE].note}"] if look.page else []
    if look.tensorboard:
        write_tensorboard(folder, animation, errors, folder / SHEET if look.sheet else None)
    return list(tasks), notes


def _targets(clip: Clip, animation: Animation) -> Targets:
    """The clip's meshes without rigid motion, by rows of the animation."""
    reading = threading.Lock()

    def targets(wanted: Sequence[int]) -> Tensor:
        with reading:
            meshes = torch.cat([clip.vertices(row, row + 1) for row in wanted])
        return meshes if animation.motion is None else remove_motion(animation.motion[list(wanted)], meshes)

    return targets
