"""Readers of scans: a mesh file for each frame, ragged arrays, and clips whose frames may each be another mesh."""

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from riginv.clips.array_facts import FACES, METADATA, frame_times
from riginv.clips.arrays import VERTICES
from riginv.clips.file_frames import vertices_of
from riginv.clips.numbered import find_frames, is_pattern, visible_files
from riginv.clips.open import SEQUENCES, open_sequence
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MAX_VERTICES, MeshSequence, ScansError, SourceFacts
from riginv.clips.units import ClipUnits
from riginv.config.building import class_of
from riginv.errors import InputError, in_short, listed
from riginv.meshes.mesh_file import MeshFile, note_on_objects
from riginv.meshes.polygons import Polygons
from riginv.meshes.reading import READERS
from riginv.meshes.stl import StlMesh
from riginv.rig.interface import RigBackend
from riginv.runs.array_files import BROKEN, DAMAGED_ZIP, check_npz
from riginv.runs.files import read_bytes
from riginv.tracking.surfaces.scans import Scan, ScanSequence
from riginv.tracking.surfaces.units import resolve_neutral_units

STILLS = {**READERS, ".stl": StlMesh}
CHECKED_BYTES = 1 << 28  # of files that are read once before the work: seconds, for what takes minutes
CLIPS = (".usd", ".usda", ".usdc", ".usdz", ".abc")  # of files that are a scan each where a path names several
SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf", *CLIPS)  # of files that may be a scan each


class FileScans(ScanSequence):
    """Mesh files, one per frame, each with any number of points.

    Args:
        path: as in `find_frames`.
        options: `missing_frames`, and `mesh`: the objects that are read; `readers` of glTF, USD and Alembic files.
    """

    def __init__(self, path: str, options: ReadingOptions) -> None:
        suffix = _suffix(Path(path))
        self.frames = find_frames(path, suffix, options.missing_frames == "bridge")
        self.options, first = options, _read(self.frames.first, options)
        notes = (*self.frames.notes, *first.notes, *options.unused(suffix[1:].upper(), not first.objects))
        notes += note_on_objects(self.frames.first, [name for name in first.objects if name in (options.mesh_names or [name])])
        facts = SourceFacts(f"scans ({suffix[1:].upper()})", notes=notes)
        super().__init__(path, self.frames.numbers, facts, None, first.unit_mm, first.up)

    def check(self, indices: Sequence[int]) -> None:
        paths = [path for index in indices if (path := self.frames.paths[index]) is not None]
        if paths and paths[0].suffix.lower() in STILLS and sum(path.stat().st_size for path in paths) <= CHECKED_BYTES:
            for index in indices:
                self.scan(index)

    def scan(self, index: int) -> Scan | None:
        path = self.frames.paths[index]
        if path is None:
            return None
        mesh = _read(path, self.options)
        polygons = mesh.polygons()
        if polygons is not None:
            polygons.check(path, len(mesh.points))
        points = mesh.points
        if self.options.mesh_names and mesh.objects:
            selected = vertices_of(mesh, self.options.mesh_names)
            points, polygons = points[selected], None if polygons is None else polygons.among(selected)
        return Scan(points, None if polygons is None else polygons.fans())


class MeshScans(ScanSequence):
    """The meshes of a clip, which need not be the rig's, nor one topology."""

    def __init__(self, sequence: MeshSequence) -> None:
        super().__init__(sequence.path, sequence.frame_numbers, sequence.facts, sequence.fps, sequence.unit_mm, sequence.up)
        self.sequence = sequence

    def scan(self, index: int) -> Scan | None:
        points, polygons = self.sequence.mesh(index)
        return Scan(points, None if polygons is None else polygons.fans())


class RaggedArrays(ScanSequence):
    """An .npz of ragged arrays, with the points of all frames one after the other.

    It holds `points (point, 3)` and `offsets (frame + 1,)`: frame f has the points from offsets[f] up to offsets[f + 1]. Meshes
    have `faces (face, 3)`, with vertex indices within their frame, and `face_offsets (frame + 1,)`; point clouds may have
    `normals (point, 3)`. Other names of the points, rate, times and frame numbers as in other clips.
    """

    def __init__(self, path: Path) -> None:
        self.arrays = _load(path)
        name, offsets = next((name for name in VERTICES if name in self.arrays), "points"), self.arrays.get("offsets")
        if name not in self.arrays or offsets is None:
            raise InputError(f"{path}: scans need the arrays points and offsets, found {', '.join(self.arrays) or 'none'}")
        self.points = points = self.arrays[name]
        _check_floats(path, name, points)
        _check_offsets(path, "offsets", offsets, len(points))
        frames, notes = len(offsets) - 1, list[str]()
        self.faces = faces = next((self.arrays[name] for name in FACES if name in self.arrays), None)
        if faces is not None:
            starts = self.arrays.get("face_offsets")
            if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or starts is None:
                raise InputError(
                    f"{path}: faces of scans are whole numbers (face, 3) with face_offsets (frame + 1,) beside them"
                )
            _check_offsets(path, "face_offsets", starts, len(faces), frames)
        if "normals" in self.arrays:
            _check_floats(path, "normals", self.arrays["normals"], len(points))
        times = frame_times(path, self.arrays, frames, notes)
        if (np.diff(times.numbers) <= 0).any():
            raise InputError(f"{path}: frame_numbers do not rise: put the frames in order")
        facts = SourceFacts("scans (NumPy .npz)", rate_source=times.rate_source, notes=tuple(notes))
        super().__init__(path, times.numbers, facts, times.fps)

    def scan(self, index: int) -> Scan | None:
        first, last = (int(value) for value in self.arrays["offsets"][index : index + 2])
        points = self.points[first:last]
        normals = self.arrays.get("normals")
        if self.faces is None:
            return Scan(points, None, None if normals is None else normals[first:last])
        start, stop = (int(value) for value in self.arrays["face_offsets"][index : index + 2])
        faces = self.faces[start:stop].astype(np.int64)
        Polygons.triangles(faces).check(self.path, len(points))
        return Scan(points, faces)


def open_scans(path: str, rig: RigBackend | None, reading: ReadingOptions) -> ScanSequence:
    """A clip of scans.

    Raises:
        InputError: it cannot be read.
    """
    given = Path(path)
    if is_ragged(path):
        return RaggedArrays(given)
    if given.suffix.lower() in STILLS or _names_several(given):
        return FileScans(path, reading)
    try:
        return MeshScans(open_sequence(path, rig, reading, as_scans=True))
    except ScansError:
        return FileScans(path, reading)


def read_scan(path: str, reading: ReadingOptions, rig: RigBackend, key: str = "scan") -> tuple[Scan, ClipUnits]:
    """A single scan and its units.

    Args:
        key: of the config, that names the file.

    Raises:
        InputError: there are several files, or too few points.
    """
    if not may_be_scan(path):
        raise InputError(f"{key}={path}: a scan is a file that ends in {listed(SUFFIXES, None)}, or an .npz: export it as one")
    scans = open_scans(path, rig, reading)
    if len(scans) != 1:
        raise InputError(f"{key}={path}: {len(scans)} scans, expected one, of a neutral face: give the file of that one")
    cleaned = scans.cleaned(0)
    if cleaned is None:
        raise InputError(f"{key}={path}: fewer than 50 points: there is nothing to fit")
    return cleaned, resolve_neutral_units(scans, rig, reading)


def holds_scans(path: str) -> bool:
    """Whether a path can only hold scans: ragged arrays, an STL file, or a file for each frame of a format that holds clips."""
    given = Path(path)
    are_files = _names_several(given) and _suffix(given) not in SEQUENCES
    return are_files or given.suffix.lower() == ".stl" or is_ragged(path)


def _names_several(given: Path) -> bool:
    """Whether a path is a folder, or a pattern of files."""
    try:
        return given.is_dir() or (is_pattern(str(given)) and not given.exists())
    except OSError:  # its reader reports it
        return False


def may_be_scan(path: str) -> bool:
    """Whether a path is of a format that scans come in."""
    return _suffix(Path(path)) in (*SUFFIXES, ".npz", ".npy", ".fbx", ".mdd", ".pc2")


def is_ragged(path: str) -> bool:
    """Whether a path is an .npz of ragged arrays."""
    given = Path(path)
    if given.suffix.lower() != ".npz":
        return False
    try:
        if not given.is_file():  # a pipe might never start
            return False
        with zipfile.ZipFile(given) as archive:
            return "offsets.npy" in archive.namelist()
    except (*DAMAGED_ZIP, OSError, ValueError):
        return False  # its reader reports what is wrong


def _read(path: Path, options: ReadingOptions) -> MeshFile:
    suffix = path.suffix.lower()
    if suffix in STILLS:
        return STILLS[suffix](path, read_bytes(path))
    known = options.readers.get(suffix[1:])
    if known is None:
        raise InputError(f"{path}: a scan is a file that ends in {listed(SUFFIXES, None)}: export it as one of these")
    reader: type[MeshSequence] = class_of(known, kind=MeshSequence)
    return reader.still(path, options)


def _suffix(given: Path) -> str:
    """The suffix of a sequence's files; in a folder, the one of `SUFFIXES` that occurs.

    Raises:
        InputError: it holds several.
    """
    if given.is_dir():
        found = {file.suffix.lower() for file in visible_files(given)}
        several = [suffix for suffix in SUFFIXES if suffix in found]
        if len(several) > 1:
            raise InputError(
                f"{given}: a folder of {listed(several)} files, expected one format: '{given}/*{several[0]}' names one"
            )
        return next(iter(several), SUFFIXES[0])
    return given.suffix.lower()


def _load(path: Path) -> dict[str, np.ndarray]:
    try:
        check_npz(path)
        with np.load(path, allow_pickle=False) as archive:
            wanted = (*VERTICES, "offsets", "face_offsets", "normals", *METADATA)
            return {name: archive[name] for name in wanted if name in archive}
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; clip=PATH names a clip") from None
    except InputError:
        raise
    except (OSError, *BROKEN, *DAMAGED_ZIP) as error:
        raise InputError(f"{path}: no .npz of scans, or a damaged one ({in_short(error)}): save it again") from None


def _check_floats(path: Path, name: str, values: np.ndarray, count: int | None = None) -> None:
    if values.ndim != 2 or values.shape[1] != 3 or values.dtype.kind != "f" or count not in (None, len(values)):
        raise InputError(f"{path}: {name} are {values.dtype} of shape {values.shape}, expected floats ({count or 'point'}, 3)")


def _check_offsets(path: Path, name: str, values: np.ndarray, last: int, frames: int | None = None) -> None:
    good = values.ndim == 1 and values.dtype.kind in "iu" and len(values) >= 2 and frames in (None, len(values) - 1)
    if not good or values[0] != 0 or int(values[-1]) != last or (np.diff(values.astype(np.int64)) < 0).any():
        raise InputError(
            f"{path}: {name} must be whole numbers that rise from 0 to {last}, one more than there are frames; found "
            f"{values.dtype} of shape {values.shape}"
        )
    if np.diff(values.astype(np.int64)).max() > MAX_VERTICES:
        raise InputError(f"{path}: a scan of more than {MAX_VERTICES} points: damaged; save it again")
