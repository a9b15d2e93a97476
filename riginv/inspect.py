"""python -m riginv.inspect PATH: what a clip, markers, a bundle, a prior or a store of poses holds, and whether a clip fits."""

from riginv.launch.command import answer_help, command

answer_help(__name__, "inspect")  # before the imports that take seconds

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console
from rich.text import Text

from riginv.animation.table import CURVES
from riginv.clips.bvh import read_bvh
from riginv.clips.clip import Clip
from riginv.clips.control_curves import are_curves, csv_curves, holds_curves, npz_curves
from riginv.clips.csv_table import read_csv
from riginv.clips.description import describe
from riginv.clips.description_text import NAMES, rows
from riginv.clips.live_link import TIMECODE, is_recording, recording_of
from riginv.clips.marker_exports import read_export
from riginv.clips.markers import SUFFIXES, MarkerClip, holds_markers, open_markers, read_marker_csv
from riginv.clips.open import TABLE, open_clip, open_clip_without_rig
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.sequence import MeshesError, ScansError
from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.errors import InputError, printable
from riginv.inference.bundle import DESCRIPTION
from riginv.inference.inverse import load_inverse
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.size import show_rig
from riginv.runs.console import show_lines
from riginv.runs.files import is_file
from riginv.runs.run_folder import BUNDLE
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.store import PoseStore
from riginv.sampling.store.summary import show as show_store
from riginv.tracking.contents import (
    Row,
    bundle_rows,
    curve_rows,
    map_rows,
    marker_rows,
    mesh_rows,
    prior_rows,
    recording_rows,
    skeleton_rows,
)
from riginv.tracking.markers.map_file import read_map
from riginv.tracking.priors.files import FACTS
from riginv.tracking.surfaces.inspection import scan_rows
from riginv.tracking.surfaces.scan_files import holds_scans, open_scans

STORE, SKELETON, MAPS = "zarr.json", ".bvh", (".yaml", ".yml")


@dataclass(frozen=True)
class InspectConfig:
    """The config of `riginv.inspect`; conf/inspect.yaml explains each key."""

    rig: ClassSpec[RigBackend] | None
    reading: ReadingOptions
    frames: FrameOptions
    clip: str
    bundle: str | None


def inspect(config: DictConfig) -> None:
    """Print what `config.clip` holds; of a clip also whether it fits the rig, if one is named."""
    settings = to_typed(config, InspectConfig)
    path = Path(settings.clip)
    if is_file(path / CURVES):  # a folder of riginv.invert
        path = path / CURVES
        settings = replace(settings, clip=str(path))
    names = None if config.get("verbose") else NAMES
    if is_file(path / STORE):
        store = PoseStore.find(StoreLocation(settings.clip))
        if store is None:
            raise InputError(f"{path}: no store of poses of riginv")
        show_store(store, {})
    elif any(is_file(folder / DESCRIPTION) for folder in (path, path / BUNDLE)):
        show_rows(path.name, bundle_rows(path, names))
    elif is_file(path / FACTS):
        rig = build_named_rig(settings)
        show_rows(path.name, prior_rows(path, rig if isinstance(rig, LinearRig) else None, names))
    elif path.suffix.lower() in MAPS and is_file(path):
        show_rows(path.name, map_rows(path, names))
        if (rig := build_named_rig(settings)) is not None:
            read_map(path, rig)
            show_lines([f"its places are on rig '{rig.name}'"], console=Console())
    elif (markers := markers_of(path)) is not None:
        show_rows(path.name, marker_rows(markers, names))
        show_lines([], markers.facts.notes, console=Console())
    else:
        show_clip_file(settings, names)


def markers_of(path: Path) -> MarkerClip | None:
    """The markers of a file of a format that holds nothing else; None for other files."""
    suffix = path.suffix.lower()
    if suffix == TABLE:
        if not is_file(path):
            return None
        return read_export(path) or (read_marker_csv(path) if holds_markers(path) else None)
    return open_markers(str(path)) if suffix in SUFFIXES else None


def show_clip_file(settings: InspectConfig, names: int | None) -> None:
    """Print what the file of a clip holds, and whether it fits the rig.

    Args:
        names: meshes, animations or shapes listed in a row, at most; None: all.

    Raises:
        InputError: it cannot be read, or does not fit.
    """
    path, rig = settings.clip, build_named_rig(settings)
    is_table, config = path.lower().endswith(TABLE), settings.rig.config if settings.rig else None
    if rig is None and (is_table or (path.lower().endswith(".npz") and holds_curves(Path(path)))):
        show_curves(Path(path), names)
        return
    if rig is None and path.lower().endswith(SKELETON):
        show_rows(Path(path).name, skeleton_rows(read_bvh(Path(path)), names))
        return
    if holds_scans(path):
        show_scans(path, settings.reading, rig)
        if rig is not None:
            show_rig(rig, config, Console())
        return
    if rig is None:
        show_frames(settings, None, names)
        return
    try:
        clip, notes = open_clip(path, rig, settings.reading, settings.frames)
    except InputError as misfit:
        if is_table:
            raise
        if isinstance(misfit, MeshesError):
            show_meshes(path, misfit, names)
        are_scans = not isinstance(misfit, MeshesError) and show_frames(settings, rig, names)  # helps to see why
        show_rig(rig, config, Console())
        if are_scans:
            return
        raise misfit from None
    show_sequence(clip, notes, names)
    show_rig(rig, config, Console())
    show_lines([f"the clip fits rig '{rig.name}'"], console=Console())


def show_frames(settings: InspectConfig, rig: RigBackend | None, names: int | None) -> bool:
    """Print what a clip holds that is not read for a rig; returns whether these are scans, whose sizes `rig` tells."""
    try:
        show_sequence(*open_clip_without_rig(settings.clip, settings.reading, settings.frames), names)
    except ScansError as error:  # a still mesh, a point cloud, or another mesh in each frame
        show_scans(settings.clip, settings.reading, rig)
        show_lines([f"scans are fitted by their surface: riginv invert rig=NAME correspondence=surface ({error})"])
        return True
    except MeshesError as error:
        show_meshes(settings.clip, error, names)
    return False


def show_meshes(path: str, error: MeshesError, names: int | None) -> None:
    """Print the meshes of a file of which it does not follow which is meant."""
    show_rows(Path(path).name, mesh_rows(error.meshes, names))
    show_lines([], ["reading.mesh=NAME reads one of them, 'reading.mesh=[NAME,NAME]' several as one mesh"], console=Console())


def show_scans(path: str, reading: ReadingOptions, rig: RigBackend | None) -> None:
    """Print what a clip of scans holds.

    Raises:
        InputError: it cannot be read.
    """
    found, notes = scan_rows(open_scans(path, rig, reading), reading, rig)
    show_rows(Path(path).name, found)
    show_lines([], notes, console=Console())


def build_named_rig(settings: InspectConfig) -> RigBackend | None:
    """The rig that the clip should fit, or None where neither a rig nor a bundle is named."""
    rig = settings.rig.build() if settings.rig else None
    return load_inverse(settings.bundle, rig).rig if settings.bundle else rig


def show_sequence(clip: Clip, notes: Sequence[str], names: int | None) -> None:
    """Print the description of a clip."""
    found = describe(clip)
    show_rows(found.file, rows(found, names))
    show_lines([], notes, found.warnings, Console())


def show_curves(path: Path, names: int | None) -> None:
    """Print what a file of curves holds: a Live Link Face recording, or the controls of a rig.

    Raises:
        InputError: it cannot be read, or is neither.
    """
    table = read_csv(path, TIMECODE) if path.suffix.lower() == TABLE else None
    if table is not None and (is_recording(table) or not are_curves(table)):
        show_rows(path.name, recording_rows(recording_of(table), names))
        return
    curves = npz_curves(path) if table is None else csv_curves(table)
    show_rows(path.name, curve_rows(curves, names))
    show_lines([], curves.notes, console=Console())


def show_rows(title: str, found: Sequence[Row]) -> None:
    """Print a table of two columns; values are not truncated."""
    console, width = Console(), max(len(name) for name, _ in found)
    console.print(Text(printable(title), "bold"), soft_wrap=True)
    for name, value in found:
        console.print(Text(f"  {name:<{width}}  {printable(value)}"), highlight=False, soft_wrap=True)


if __name__ == "__main__":
    command("inspect")(inspect)()
