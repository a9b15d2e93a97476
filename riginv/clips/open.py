"""Opening a clip: the reader that its name calls for, checked against the rig, in millimetres."""

from collections.abc import Callable, Mapping
from pathlib import Path

from riginv.clips.arrays import ArrayClip
from riginv.clips.clip import Clip
from riginv.clips.control_curves import csv_curves, holds_curves, npz_curves
from riginv.clips.csv_table import read_csv
from riginv.clips.file_frames import ObjFrames, PlyFrames
from riginv.clips.live_link import TIMECODE, RecordedShapes, is_recording
from riginv.clips.numbered import is_pattern, visible_files
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.point_caches import MddCache, Pc2Cache
from riginv.clips.posed_curves import PosedCurves
from riginv.clips.sequence import MeshSequence
from riginv.clips.topology import check_topology
from riginv.clips.units import resolve_units
from riginv.clips.vertex_map import MappedVertices
from riginv.config.building import class_of
from riginv.errors import InputError
from riginv.rig.interface import RigBackend

FRAMES: Mapping[str, type[MeshSequence]] = {".obj": ObjFrames, ".ply": PlyFrames}
READERS: Mapping[str, Callable[[str, ReadingOptions], MeshSequence]] = {
    ".npz": ArrayClip,
    ".npy": ArrayClip,
    ".mdd": MddCache,
    ".pc2": Pc2Cache,
    **FRAMES,
}
PLUG_INS = {
    **dict.fromkeys((".glb", ".gltf", ".vrm"), "rigs.gltf.clip.GltfClip"),
    **dict.fromkeys((".abc", ".fbx"), "rigs.blender.clip.BlenderClip"),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "rigs.usd.clip.UsdClip"),
}
KNOWN = (*READERS, *PLUG_INS, ".csv")


def open_clip(path: str, rig: RigBackend, reading: ReadingOptions, frames: FrameOptions) -> tuple[Clip, list[str]]:
    """A clip of a rig, and notes about what was guessed.

    Raises:
        InputError: it cannot be read, is no clip of the rig, or a value about it is wrong.
    """
    sequence = open_sequence(path, rig, reading)
    if reading.vertices is not None:
        sequence = MappedVertices(sequence, Path(str(reading.vertices)))
    note = check_topology(sequence, rig, reading.check_faces)
    units = resolve_units(sequence, rig, reading.unit, reading.scale, reading.up, reading.fps)
    clip = Clip(sequence, units, frames.first, frames.last, frames.exclude)
    return clip, [*sequence.facts.notes, *units.notes, *([note] if note else [])]


def open_sequence(path: str, rig: RigBackend | None, options: ReadingOptions) -> MeshSequence:
    """Open a clip with the reader that its name calls for.

    Args:
        rig: whose mesh it should hold; whose shapes or controls it should move; None only where its reader needs none.
        options: what the user says about the file.

    Raises:
        InputError: no reader knows the name, or the file is missing or damaged.
    """
    given = Path(path)
    suffix = given.suffix.lower()
    if _is_folder(given):
        inside = {file.suffix.lower() for file in visible_files(given)} & set(FRAMES)
        if len(inside) != 1:
            which = "; 'FOLDER/*.obj' names the OBJ files of one that holds both" if inside else ""
            raise InputError(f"{path}: a folder, expected to hold OBJ or PLY files, one for each frame, and not both{which}")
        return FRAMES[inside.pop()](path, options)
    if suffix in FRAMES:
        return FRAMES[suffix](path, options)
    if is_pattern(path) and not given.exists():
        raise InputError(f"{path}: patterns are for OBJ and PLY files, one for each frame: expected one ending in .obj or .ply")
    if suffix == ".npz" and holds_curves(given):
        return PosedCurves(npz_curves(given), rig, options)
    if suffix in READERS:
        return READERS[suffix](path, options)
    if suffix == ".csv":
        table = read_csv(given, TIMECODE)
        return RecordedShapes(table, rig, options) if is_recording(table) else PosedCurves(csv_curves(table), rig, options)
    if suffix in PLUG_INS:
        return class_of(PLUG_INS[suffix], kind=MeshSequence).for_rig(path, options, rig)
    raise InputError(f"{path}: clips end in {', '.join(KNOWN)}; convert it to one of these")


def open_without_rig(path: str, options: ReadingOptions) -> MeshSequence:
    """Open a clip where there is no rig: its reader chooses the meshes by itself.

    Raises:
        InputError: no reader knows the name, the file is missing or damaged, or only a rig can make meshes of it.
    """
    suffix = Path(path).suffix.lower()
    if _is_folder(Path(path)) or suffix in READERS or suffix not in (*PLUG_INS, ".csv"):
        return open_sequence(path, None, options)
    if suffix == ".csv":
        raise InputError(f"{path}: curves need a rig to become meshes: name it with rig=NAME or bundle=DIR")
    return class_of(PLUG_INS[suffix], kind=MeshSequence)(path, options)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError) as error:
        raise InputError(f"{str(path)[:200]}: cannot be looked for: {error}") from None
