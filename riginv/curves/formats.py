"""The formats that curves are written in, each a file of its own."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from riginv.curves.animation import Animation, FrameErrors
from riginv.curves.table import CURVES, FRAMES, SIDECAR, write_curves, write_frames, write_sidecar
from riginv.errors import InputError
from riginv.rig import RigBackend


class Format(NamedTuple):
    """One format.

    Attributes:
        file: its name in the folder.
        check: raises InputError where a rig cannot be written in it.
        write: writes an animation to a path, whole or not at all.
    """

    file: str
    check: Callable[[RigBackend], None]
    write: Callable[[Path, Animation], None]


def formats() -> dict[str, Format]:
    """The formats beside curves.csv and frames.csv, by name."""
    return {}


def check_formats(rig: RigBackend, names: Sequence[str]) -> None:
    """To be asked before any work.

    Raises:
        InputError: a format is not known, the rig cannot be written in it, or a package that it takes is missing.
    """
    known = formats()
    for name in names:
        if name != "csv" and name not in known:
            raise InputError(f"formats: '{name}' is not known; choose from csv, {', '.join(known)}")
    for name in names:
        if name != "csv":
            known[name].check(rig)


def write_formats(folder: Path, animation: Animation, errors: FrameErrors, names: Sequence[str]) -> list[Path]:
    """Write curves.csv, its sidecar curves.json, frames.csv, and a file for each further format.

    Args:
        names: of formats; csv goes without saying.

    Returns:
        the files.

    Raises:
        InputError: as `check_formats`; nothing is written then.
    """
    check_formats(animation.rig, names)
    write_curves(folder / CURVES, animation)
    write_sidecar(folder / SIDECAR, animation)
    write_frames(folder / FRAMES, animation, errors)
    paths = [folder / CURVES, folder / SIDECAR, folder / FRAMES]
    known = formats()
    for name in dict.fromkeys(names):
        if name != "csv":
            path = folder / known[name].file
            known[name].write(path, animation)
            paths.append(path)
    return paths
