"""python -m riginv.invert: a clip of meshes in, animation curves out, judged frame by frame by the true rig."""

import importlib.metadata
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from riginv.animation.animation import Animation
from riginv.animation.formats import check_formats
from riginv.clips.description import describe
from riginv.clips.description_text import show_clip
from riginv.clips.open import open_clip
from riginv.clips.options import clip_options
from riginv.config.building import ClassSpec
from riginv.config.typed import MeshSpaceConfig, convert
from riginv.config.validation import validate
from riginv.errors import InputError
from riginv.inference.bundle import read_bundle
from riginv.inference.inverse import load_inverse
from riginv.launch.command import command
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.size import show_rig
from riginv.runs.checksums import SUMS, sha256
from riginv.runs.files import atomic_write
from riginv.runs.locks import exclusive_lock
from riginv.runs.run_folder import plain_config
from riginv.tracking.assembly import WHOLE_CLIP, build_parts, chosen_method
from riginv.tracking.reach import with_reach
from riginv.tracking.report import InversionProgress, show
from riginv.tracking.results import check_after, write_results
from riginv.tracking.run import Smoothness, invert_clip, invert_smoothly
from riginv.tracking.scans import (
    SURFACE,
    PreparedScans,
    chosen_correspondence,
    frame_errors,
    prepare_scans,
    remarks_of,
    write_scan_table,
)
from riginv.tracking.surfaces.tracking import track_scans
from riginv.training.assembly import build_rig, build_true_rig


def invert(config: DictConfig) -> None:
    """Invert `config.clip` and leave a folder `config.out` with its curves, and how good each frame is."""
    plain = plain_config(config)
    validate(plain)
    chosen_method(plain)
    out = free_folder(plain["out"])
    named = named_rig(plain) if plain["bundle"] else None
    inverse = load_inverse(plain["bundle"], named) if plain["bundle"] else None
    rig = inverse.rig if inverse else build_rig(named_in(plain), convert(plain["mesh_space"], MeshSpaceConfig, "mesh_space"))
    judge = plain["true_rig"] if plain["true_rig"].get("_target_") else None
    true_rig = build_true_rig(ClassSpec.read(judge, RigBackend, "true_rig") if judge else None, named or rig)
    true_rig = true_rig if true_rig.held_out is None else rig
    if not isinstance(plain["formats"], list):
        raise InputError(f"formats is {plain['formats']!r}, expected a list: formats=[csv,glb]")
    check_formats(true_rig, plain["formats"])
    check_after(plain["after"], plain["look"])
    reading, frames = clip_options(plain)
    correspondence, said = chosen_correspondence(plain, true_rig, reading)
    if correspondence == SURFACE:
        show_rig(true_rig, plain["rig"])
        invert_surface(plain, rig, true_rig, prepare_scans(plain, rig, reading, frames, said), out)
        return
    clip, notes = open_clip(str(plain["clip"]), true_rig, reading, frames)
    described = show_clip(clip)
    show_rig(true_rig, plain["rig"])
    notes = [*said, *notes]
    parts = build_parts(plain, clip, rig, true_rig, inverse)
    with exclusive_lock(out), InversionProgress(len(clip), [*notes, *parts.notes]) as progress:
        free_folder(out)
        arguments = (clip, parts.inverter, parts.judge, plain["window"], progress.advance)
        if parts.method == WHOLE_CLIP:
            solver = plain["solver"]
            how = Smoothness(*(solver[key] for key in ("smoothness", "clip_steps", "blur", "mean_steps")))
            found = invert_smoothly(*arguments, how)
        else:
            found = invert_clip(*arguments)
        progress.advance("the rig's reach", 0)
        errors = with_reach(found.errors, clip, found, parts.judge)
        facts = made_by(plain, parts.method)
        source = Path(plain["clip"]).name
        animation = Animation(true_rig, found.controls, clip.fps, clip.frame_numbers, found.motion, source, facts)
        with atomic_write(out) as beside:
            beside.mkdir()
            files, remarks = write_results(beside, clip, animation, errors, plain, progress.advance)
    remarks += [f"warning: {warning}" for warning in describe(clip).new_warnings(described)]
    show(animation, errors, true_rig, out, files, remarks)


def invert_surface(config: dict[str, Any], rig: LinearRig, true_rig: RigBackend, scans: PreparedScans, out: Path) -> None:
    """Invert a clip of scans by their surfaces, and leave the folder `out`."""
    numbers = scans.frame_numbers
    with exclusive_lock(out), InversionProgress(len(numbers), scans.notes) as progress:
        free_folder(out)
        track = track_scans(scans.solver, scans.scans, scans.meaning, scans.rows, scans.smoothness, progress.advance)
        facts, source = made_by(config, SURFACE), Path(config["clip"]).name
        motion = track.motion if scans.solver.moves else None
        animation = Animation(true_rig, track.controls, scans.meaning.fps, numbers, motion, source, facts)
        errors, remarks = frame_errors(track, numbers), remarks_of(track)
        with atomic_write(out) as beside:
            beside.mkdir()
            files, more = write_results(beside, None, animation, errors, config, progress.advance)
            files += write_scan_table(beside, track, numbers)
    rows = ("scan's points from the rig", "rig's skin from the scan")
    show(animation, errors, true_rig, out, files, [*remarks, *more], "mean surface distances", rows)


def free_folder(out: Any) -> Path:
    """The folder for the results.

    Raises:
        InputError: something is there already.
    """
    path = Path(str(out))
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise InputError(f"out={out}: it is there already; give another folder, or remove it")
    return path


def named_rig(config: dict[str, Any]) -> Any:
    """The rig that was named beside a bundle, or None: the bundle's own."""
    return ClassSpec.read(config["rig"], RigBackend, "rig").build() if config["rig"].get("_target_") else None


def named_in(config: dict[str, Any]) -> ClassSpec[RigBackend]:
    """The rig that a config names.

    Raises:
        InputError: it names neither a bundle nor a rig.
    """
    if not config["rig"].get("_target_"):
        raise InputError("give bundle=DIR, a trained inverse, or rig=NAME: what is the clip a mesh of?")
    return ClassSpec.read(config["rig"], RigBackend, "rig")


def made_by(config: dict[str, Any], method: str) -> dict[str, Any]:
    """What made the curves, for their sidecar."""
    facts = {"riginv": importlib.metadata.version("riginv"), "method": method, "refine": config["refine"]}
    if config["bundle"]:
        facts["bundle"] = sha256(read_bundle(config["bundle"]).folder / SUMS)
    return facts


if __name__ == "__main__":
    command("invert")(invert)()
