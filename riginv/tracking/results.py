"""What an inversion leaves in its folder: curves in every format that was asked for, and what to look at."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from riginv.animation.animation import Animation, FrameErrors
from riginv.animation.formats import write_formats
from riginv.animation.reduction import reduced
from riginv.animation.resampling import resampled
from riginv.clips.clip import Clip
from riginv.clips.description import describe
from riginv.clips.description_text import in_short, rows
from riginv.errors import InputError
from riginv.tracking.rigid import remove_motion
from riginv.viewer.page import ClipSource, write_viewer
from riginv.viewer.sheet import write_sheet
from riginv.viewer.tensorboard import write_tensorboard

PAGE, SHEET = "look.html", "frames.png"


def check_after(after: Mapping[str, Any], look: Mapping[str, Any]) -> None:
    """To be asked before any work.

    Raises:
        InputError: a value of `after` or `look` cannot be meant.
    """
    for key in ("fps", "keys_mm"):
        value = after[key]
        if value is not None and (not isinstance(value, int | float) or isinstance(value, bool) or not 0 < value < 1e6):
            raise InputError(f"after.{key} is {value!r}, expected a number above 0, or null")
    for group, flags in (("after", {"swap_mouth": after["swap_mouth"]}), ("look", look)):
        for key, value in flags.items():
            if not isinstance(value, bool):
                raise InputError(f"{group}.{key} is {value!r}, expected true or false")


def write_results(
    folder: Path,
    clip: Clip | None,
    animation: Animation,
    errors: FrameErrors,
    config: Mapping[str, Any],
    advance: Callable[[str, int], None],
) -> tuple[list[str], list[str]]:
    """Write the curves, and what to look at, into a folder.

    Args:
        clip: None: of scans, which have no mesh of the rig's to compare with: page and picture are left out.
        config: `formats`, `after` and `look` of riginv.invert.
        advance: told what is done.

    Returns:
        the names of the files, and what the user should know of them.
    """
    after, look, notes = config["after"], config["look"], []
    curves = resampled(animation, after["fps"]) if after["fps"] else animation
    if after["keys_mm"]:
        advance("keys", 0)
        reduction = reduced(curves, after["keys_mm"])
        curves = reduction.animation
        notes.append(
            f"{reduction.keys:,} of {reduction.keys_before:,} keys are kept; they move no vertex by more than "
            f"{reduction.worst_mm:.3g} mm from where a key at every frame has it"
        )
    advance("curves", 0)
    described = None if clip is None else describe(clip)
    read = None if described is None else described.as_json()
    paths = write_formats(folder, curves, errors, config["formats"], after["swap_mouth"], read)
    if described is None:
        return [path.name for path in paths], notes
    targets = _targets(clip, animation)
    if look["page"]:
        advance("page", 0)
        paths.append(folder / PAGE)
        source = ClipSource(in_short(described), rows(described, None), described.warnings, described.notes)
        shown = write_viewer(folder / PAGE, animation, errors, targets, clip=source)
        notes.append(f"{PAGE}: {shown.note}")
    if look["sheet"]:
        paths.append(folder / SHEET)
        write_sheet(folder / SHEET, animation, errors, targets)
    if look["tensorboard"]:
        write_tensorboard(folder, animation, errors, folder / SHEET if look["sheet"] else None)
        paths.append(folder)
    return [path.name for path in paths if path != folder], [note for note in notes if note]


def _targets(clip: Clip, animation: Animation) -> Callable[[Sequence[int]], Tensor]:
    """The meshes that were asked for, by the rows of the animation, without their rigid motion."""

    def targets(wanted: Sequence[int]) -> Tensor:
        meshes = torch.cat([clip.vertices(row, row + 1) for row in wanted])
        return meshes if animation.motion is None else remove_motion(animation.motion[list(wanted)], meshes)

    return targets
