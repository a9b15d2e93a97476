"""Clips of scans for riginv.invert: `correspondence=surface`."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from riginv.animation.animation import FrameErrors
from riginv.animation.table import write_rows
from riginv.clips.clip import excluded_frames
from riginv.clips.open import open_sequence
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.topology import check_topology
from riginv.clips.units import ClipUnits
from riginv.errors import InputError
from riginv.rig.interface import LinearRig, RigBackend
from riginv.runs.array_files import DAMAGED_ZIP
from riginv.tracking.priors.files import load_prior
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import ControlPrior
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.clip import ScanSmoothness
from riginv.tracking.surfaces.scans import SUFFIXES, FileScans, MeshScans, RaggedArrays, ScanSequence
from riginv.tracking.surfaces.solving import ScanSettings, ScanSolver
from riginv.tracking.surfaces.tracking import ScanTrack
from riginv.tracking.surfaces.units import resolve_scan_units

AUTO, VERTICES, SURFACE = "auto", "vertices", "surface"
TABLE = "scans.csv"
MOST_NAMES = 12  # of controls that a remark names
CORRESPONDENCES = (AUTO, VERTICES, SURFACE)


def resolve_correspondence(config: Mapping[str, Any], rig: RigBackend, reading: ReadingOptions) -> tuple[str, list[str]]:
    """`vertices` or `surface`, and what the user should know.

    Raises:
        InputError: it is neither, or a file cannot be read.
    """
    given = config["correspondence"]
    if given not in CORRESPONDENCES:
        raise InputError(f"correspondence is {given!r}, expected one of {', '.join(CORRESPONDENCES)}")
    if given != AUTO or config["bundle"] or reading.vertices is not None or Path(str(config["clip"])).suffix == ".csv":
        return (VERTICES if given == AUTO else given), []
    if _is_ragged(str(config["clip"])):
        return SURFACE, ["scans of their own topology: fitted by their surface (correspondence=surface)"]
    try:
        sequence = open_sequence(str(config["clip"]), rig, reading)
        check_topology(sequence, rig, reading.check_faces)
    except InputError as error:
        if "none of the rig's" in str(error) or "must hold the rig's own mesh" in str(error):
            reason = str(error).partition(": ")[2].partition(": ")[0]
            return SURFACE, [f"{reason}: fitted by its surface (correspondence=vertices refuses such clips)"]
        raise
    return VERTICES, ["vertices in the rig's own order taken (correspondence=surface fits any mesh by its surface)"]


def open_scans(path: str, rig: RigBackend, reading: ReadingOptions) -> ScanSequence:
    """A clip of scans.

    Raises:
        InputError: it cannot be read.
    """
    given = Path(path)
    if _is_ragged(path):
        return RaggedArrays(given)
    if given.suffix.lower() in SUFFIXES or given.is_dir():
        return FileScans(path, reading)
    return MeshScans(open_sequence(path, rig, reading))


def _is_ragged(path: str) -> bool:
    given = Path(path)
    if given.suffix.lower() != ".npz":
        return False
    try:
        if not given.is_file():  # a pipe might never start
            return False
        with zipfile.ZipFile(given) as archive:
            return "offsets.npy" in archive.namelist()
    except (*DAMAGED_ZIP, OSError, ValueError):
        return False  # whoever opens it says so


@dataclass(frozen=True)
class PreparedScans:
    """A clip of scans, and everything that solves it, built once.

    Attributes:
        scans, units: the clip, and what its numbers mean.
        solver: of its frames.
        rows: the number of each frame in the clip, -1 for one that is left out.
        frame_numbers: as the source counts them, `(frame,)`.
        smoothness: of the curves; None: each frame for itself.
        notes: what was guessed.
    """

    scans: ScanSequence
    units: ClipUnits
    solver: ScanSolver
    rows: list[int]
    frame_numbers: torch.Tensor
    smoothness: ScanSmoothness | None
    notes: list[str]


def prepare_scans(
    config: Mapping[str, Any], rig: LinearRig, reading: ReadingOptions, frames: FrameOptions, said: list[str]
) -> PreparedScans:
    """Open a clip of scans.

    Raises:
        InputError: a value is wrong, or the clip cannot be read.
    """
    _refuse(config)
    scans = open_scans(str(config["clip"]), rig, reading)
    units = resolve_scan_units(scans, rig, reading)
    prior, about = resolve_prior(config["prior"], rig)
    numbers = scans.frame_numbers
    first = numbers[0] if frames.first is None else frames.first
    last = numbers[-1] if frames.last is None else frames.last
    inside = (numbers >= first) & (numbers <= last)
    if not inside.any():
        raise InputError(f"{scans.path}: frames {first} to {last} were asked for, it has {numbers[0]} to {numbers[-1]}")
    kept = torch.tensor(numbers[inside])
    gone = excluded_frames(scans.path, kept, frames.exclude)
    rows = [-1 if out else int(row) for row, out in zip(inside.nonzero()[0], gone.tolist())]
    settings = ScanSettings(noise_mm=config["noise_mm"])
    solver = ScanSolver(rig, prior, settings, config["motion"] != "keep", stability_weights(rig).cpu().numpy())
    smoothness = ScanSmoothness() if config["method"] in (None, "clip") else None
    return PreparedScans(scans, units, solver, rows, kept, smoothness, [*said, *units.notes, about])


def _refuse(config: Mapping[str, Any]) -> None:
    """Raises InputError where something is asked for that fits of surfaces do not know."""
    if config["bundle"]:
        raise InputError("correspondence=surface needs no network: give rig=NAME in place of bundle=DIR")
    if config["method"] not in (None, "clip", "levenberg_marquardt"):
        raise InputError(f"method={config['method']} is not for scans: leave it out, or method=levenberg_marquardt")
    controls = config["controls"]
    asked = [key for key in ("freeze", "hold", "static", "weights", "symmetric", "exclusive", "mask") if controls[key]]
    if asked or controls["activate"] != ["*"]:
        raise InputError(f"controls.{(asked or ['activate'])[0]} is not for correspondence=surface yet: leave it out")


def resolve_prior(path: Any, rig: LinearRig) -> tuple[ControlPrior, str]:
    """The prior of a file, or the rig's default one; and which it is."""
    if path is not None:
        prior = load_prior(Path(str(path)), rig)
        return prior, f"prior of {path}: {prior.source}"
    return default_prior(rig), "no prior=FILE was given: performances that riginv makes up say which controls go together"


def frame_errors(track: ScanTrack, numbers: torch.Tensor) -> FrameErrors:
    """The distances of a track as a clip's errors: of each scan's points from the rig, no vertex named."""
    zero = torch.zeros(len(numbers), dtype=torch.long)
    return FrameErrors(track.scan_mm, track.rig_mm, zero, [""] * len(numbers), track.flags, numbers)


def remarks_of(track: ScanTrack) -> list[str]:
    """What the user should know of a track, in sentences."""
    found = list(track.notes)
    if track.open_controls:
        names = ", ".join(track.open_controls[:MOST_NAMES])
        more = f" and {len(track.open_controls) - MOST_NAMES} more" if len(track.open_controls) > MOST_NAMES else ""
        found.append(f"the scans do not determine {names}{more}: they stay where the prior has them")
    seen = float(track.seen.nanmedian())
    found.append(f"the scans see {seen:.0%} of the rig's skin; truth is not known: distances are those of the two surfaces")
    return found


def write_scan_table(folder: Path, track: ScanTrack, numbers: torch.Tensor) -> list[str]:
    """Write scans.csv: how each scan was met."""
    columns = (numbers, track.scan_mm, track.rig_mm, track.seen, track.explained)
    rows = [
        [*(f"{value:.6g}" for value in row), " ".join(flags)]
        for *row, flags in zip(*(c.tolist() for c in columns), track.flags)
    ]
    header = ["frame", "scan_to_rig_mm", "rig_to_scan_mm", "rig_seen", "scan_explained", "flags"]
    write_rows(folder / TABLE, header, rows)
    return [TABLE]
