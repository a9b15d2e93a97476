"""Opening of clips with the reader for their suffix, comparison with the rig, and conversion to millimetres."""

from collections.abc import Mapping
from pathlib import Path

from riginv.clips.arrays import ArrayClip
from riginv.clips.clip import Clip
from riginv.clips.control_curves import csv_curves, holds_curves, npz_curves
from riginv.clips.csv_table import read_csv
from riginv.clips.file_frames import ObjFrames, PlyFrames
from riginv.clips.live_link import TIMECODE, RecordedShapes, is_recording
from riginv.clips.markers import SUFFIXES as MARKER_SUFFIXES
from riginv.clips.markers import holds_markers
from riginv.clips.numbered import is_pattern, visible_files
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.point_caches import MddCache, Pc2Cache
from riginv.clips.posed_curves import PosedCurves
from riginv.clips.sequence import MeshSequence, Reader
from riginv.clips.topology import check_topology
from riginv.clips.units import resolve_units, resolve_units_without_rig
from riginv.clips.vertex_map import MappedVertices
from riginv.config.building import class_of
from riginv.errors import InputError
from riginv.rig.interface import RigBackend

SEQUENCES: Mapping[str, Reader] = {".obj": ObjFrames, ".ply": PlyFrames}  # one file per frame
READERS: Mapping[str, Reader] = {".npz": ArrayClip, ".npy": ArrayClip, ".mdd": MddCache, ".pc2": Pc2Cache, **SEQUENCES}
TABLE = ".csv"  # curves, which need a rig
MARKERS = tuple(suffix for suffix in MARKER_SUFFIXES if suffix != TABLE)
RIGS = {".blend": "blender", ".dna": "dna"}  # suffixes of rigs that users give as clips, and the config that reads them


def open_clip(
    path: str, rig: RigBackend, reading: ReadingOptions, frames: FrameOptions, sequence: MeshSequence | None = None
) -> tuple[Clip, list[str]]:
    """A clip of a rig, and notes on what was guessed.

    Args:
        sequence: what `open_sequence` gave for these, where the file is open by now.

    Raises:
        InputError: it cannot be read, or is no clip of the rig.
    """
    sequence = open_sequence(path, rig, reading) if sequence is None else sequence
    if reading.vertices is not None:
        sequence = MappedVertices(sequence, Path(str(reading.vertices)))
    note = check_topology(sequence, rig, reading.check_faces)
    units = resolve_units(sequence, rig, reading)
    clip = Clip(sequence, units, frames.first, frames.last, frames.exclude)
    return clip, [*sequence.facts.notes, *units.notes, *([note] if note else [])]


def open_clip_without_rig(path: str, reading: ReadingOptions, frames: FrameOptions) -> tuple[Clip, list[str]]:
    """A clip, in the file's own unit where the file gives none, and notes on what was guessed.

    Raises:
        InputError: it cannot be read, or only a rig can make meshes of it.
    """
    sequence = open_sequence(path, None, reading)
    units = resolve_units_without_rig(sequence, reading)
    clip = Clip(sequence, units, frames.first, frames.last, frames.exclude)
    return clip, [*sequence.facts.notes, *units.notes]


def open_sequence(path: str, rig: RigBackend | None, options: ReadingOptions, as_scans: bool = False) -> MeshSequence:
    """Open a clip with the reader for its suffix.

    Args:
        rig: its mesh chooses among the meshes of a scene, its shapes or controls turn curves into meshes; None: no rig.
        options: how the file is read; `readers` adds suffixes.
        as_scans: whether each frame may be another mesh, for `MeshSequence.mesh`.

    Raises:
        InputError: there is no reader for the suffix, the file is missing or damaged, or it needs a rig.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if _is_folder(file):
        return _open_folder(path, options)
    if suffix in SEQUENCES:
        return SEQUENCES[suffix](path, options)
    if is_pattern(path) and not file.exists():
        raise InputError(f"{path}: patterns are for OBJ and PLY files, one for each frame: expected one ending in .obj or .ply")
    if suffix == TABLE or (suffix == ".npz" and holds_curves(file)):
        return _open_curves(file, rig, options)
    if suffix in READERS:
        return READERS[suffix](path, options)
    if suffix.removeprefix(".") in options.readers:
        reader_class: type[MeshSequence] = class_of(options.readers[suffix.removeprefix(".")], kind=MeshSequence)
        reader: Reader = reader_class
        if as_scans:
            return reader_class.for_scans(path, options, rig)
        return reader(path, options) if rig is None else reader_class.for_rig(path, options, rig)
    if suffix in MARKERS:
        raise _markers_given(path)
    if suffix in RIGS:
        raise InputError(f"{path}: a rig, and no clip: rig={RIGS[suffix]} rig.file={path}")
    suffixes = (*READERS, *(f".{name}" for name in options.readers), TABLE, ".stl", *MARKERS)
    raise InputError(f"{path}: clips end in {', '.join(suffixes)}; export the mesh from its program in one of these")


def _markers_given(path: str | Path) -> InputError:
    return InputError(
        f"{path}: markers, which riginv.invert takes with correspondence=markers markers=MAP.yaml, a map of where each is on "
        f"the rig (riginv.markers proposes it)"
    )


def _open_folder(path: str, options: ReadingOptions) -> MeshSequence:
    inside = {file.suffix.lower() for file in visible_files(Path(path))} & set(SEQUENCES)
    if len(inside) != 1:
        found = "both: 'FOLDER/*.obj' names its OBJ files" if inside else "none"
        raise InputError(f"{path}: a folder, expected to hold OBJ or PLY files, one for each frame, found {found}")
    return SEQUENCES[inside.pop()](path, options)


def _open_curves(path: Path, rig: RigBackend | None, options: ReadingOptions) -> MeshSequence:
    if rig is None:
        raise InputError(f"{path}: curves need a rig to become meshes: name it with rig=NAME or bundle=DIR")
    if path.suffix.lower() != TABLE:
        return PosedCurves(npz_curves(path), rig, options)
    table = read_csv(path, TIMECODE)
    if not is_recording(table) and not {*rig.control_names} & {*table.header} and holds_markers(path):
        raise _markers_given(path)
    return RecordedShapes(table, rig, options) if is_recording(table) else PosedCurves(csv_curves(table), rig, options)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError) as error:
        raise InputError(f"{str(path)[:200]}: cannot be looked for: {error}") from None
