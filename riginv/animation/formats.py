"""The registry of curve formats, each with one file."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from riginv.animation import blender_script, bvh, glb, live_link, maya, usd
from riginv.animation.animation import Animation, FrameErrors
from riginv.animation.table import CURVES, FRAMES, SIDECAR, write_curves, write_frames, write_sidecar
from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.threads import workers


class Format(NamedTuple):
    """A curve format.

    Attributes:
        file: name of its file.
        check: raises InputError if a rig cannot be written in it.
        write: writes an animation to a path, atomically.
    """

    file: str
    check: Callable[[RigBackend], None]
    write: Callable[..., None]


FORMATS = {
    "livelink": Format(live_link.FILE, live_link.check, live_link.write),
    "glb": Format(glb.FILE, glb.check, glb.write),
    "usd": Format(usd.FILE, usd.check, usd.write),
    "anim": Format(maya.FILE, maya.check, maya.write),
    "bvh": Format(bvh.FILE, bvh.check, bvh.write),
    "blender": Format(blender_script.FILE, blender_script.check, blender_script.write),
}


def check_formats(rig: RigBackend, names: Sequence[str]) -> None:
    """Check formats before any work.

    Raises:
        InputError: a format is not known, the rig cannot be written in it, or a package is missing.
    """
    for name in names:
        if name != "csv" and name not in FORMATS:
            raise InputError(f"formats: '{name}' is not known; choose from csv, {', '.join(FORMATS)}")
    for name in names:
        if name != "csv":
            FORMATS[name].check(rig)


def write_formats(
    folder: Path,
    animation: Animation,
    errors: FrameErrors | Callable[[], FrameErrors],
    names: Sequence[str],
    swap_mouth: bool = False,
    clip: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Write curves.csv, its sidecar curves.json, frames.csv, and a file for each further format.

    Args:
        errors: of the frames; a function finds them while another thread writes curves, where the rig is a `LinearRig`.
        names: of formats; csv is always written.
        swap_mouth: exchange MouthLeft and MouthRight in Live Link Face's CSV.
        clip: description of the clip, for curves.json.

    Returns:
        paths of the files.

    Raises:
        InputError: as `check_formats`; nothing is written then.
    """
    check_formats(animation.rig, names)
    formats = {name: FORMATS[name] for name in names if name != "csv"}

    def write() -> None:
        write_curves(folder / CURVES, animation)
        for name, each in formats.items():
            each.write(folder / each.file, animation, **({"swap_mouth": swap_mouth} if name == "livelink" else {}))

    find = errors if callable(errors) else lambda: errors
    is_safe = isinstance(animation.rig, LinearRig)  # others are posed by one thread at a time
    tasks: list[Callable[[], FrameErrors | None]] = [find, write]
    found = (workers().run(tasks) if is_safe else [task() for task in tasks])[0]
    assert found is not None
    write_sidecar(folder / SIDECAR, animation, found, clip)
    write_frames(folder / FRAMES, animation, found)
    return [folder / file for file in (CURVES, SIDECAR, FRAMES, *(each.file for each in formats.values()))]
