"""Clips of scans: meshes or point clouds whose number of points may differ from frame to frame."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riginv.clips.numbered import find_frames, visible_files
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MAX_VERTICES, MeshSequence
from riginv.errors import InputError, in_short
from riginv.meshes.polygons import Polygons
from riginv.meshes.reading import read_mesh
from riginv.runs.array_files import BROKEN, DAMAGED_ZIP, check_npz
from riginv.tracking.surfaces.triangles import PointCloud, Surface, TriangleMesh

FEWEST_POINTS = 50
SUFFIXES = (".obj", ".ply")


class Scan(NamedTuple):
    """One scan, in the units and axes of its file.

    Attributes:
        points: `(point, 3)`.
        faces: `(face, 3)`; None for a point cloud.
        normals: `(point, 3)` where a point cloud has them; None: they are estimated.
    """

    points: np.ndarray
    faces: np.ndarray | None = None
    normals: np.ndarray | None = None

    def cleaned(self) -> "Scan | None":
        """Without points that are not finite, faces that use them or have no area, and, of a mesh, points that no face uses.

        None where fewer than 50 points remain: there is nothing to fit.
        """
        known = np.isfinite(self.points).all(axis=1)
        faces, used = self.faces, known
        if faces is not None:
            corners = np.where(known[:, None], self.points, 0.0)[faces]
            area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
            faces = faces[known[faces].all(axis=1) & (area > 0)]
            used = np.zeros(len(known), bool)
            used[faces] = True
        if used.sum() < FEWEST_POINTS:
            return None
        renumbered = np.cumsum(used) - 1
        normals = None if self.normals is None else self.normals[used]
        return Scan(self.points[used], None if faces is None else renumbered[faces], normals)

    def surface(self, mm: float, axes: np.ndarray) -> Surface:
        """As a surface in millimetres, y up.

        Args:
            mm: to a unit.
            axes: `(3, 3)`: what turns a point of the file upright.
        """
        points = mm * self.points.astype(np.float64) @ axes.T
        if self.faces is not None:
            return TriangleMesh(points, self.faces)
        return PointCloud(points, None if self.normals is None else self.normals @ axes.T)


class ScanSequence(ABC):
    """Scans, one after the other; one is in memory at a time.

    Attributes:
        path: what messages call it.
        frame_numbers: as the source counts them, `(frame,)`, rising.
        fps, unit_mm, up: as in `MeshSequence`.
    """

    def __init__(
        self,
        path: str | Path,
        frame_numbers: np.ndarray,
        fps: float | None = None,
        unit_mm: float | None = None,
        up: str | None = None,
    ) -> None:
        self.path, self.frame_numbers = str(path), np.asarray(frame_numbers, np.int64)
        self.fps, self.unit_mm, self.up = fps, unit_mm, up
        if not len(self.frame_numbers):
            raise InputError(f"{path}: no frames in it; expected at least one scan: export it again")

    def __len__(self) -> int:
        return len(self.frame_numbers)

    @abstractmethod
    def scan(self, number: int) -> Scan | None:
        """The scan of a frame, counted from 0; None where there is none.

        Raises:
            InputError: the file turns out to be damaged there.
        """


class FileScans(ScanSequence):
    """OBJ or PLY files, one for each frame, of any number of points.

    Args:
        path: as in `find_frames`.
        options: `missing_frames`.
    """

    def __init__(self, path: str, options: ReadingOptions) -> None:
        self.frames = find_frames(path, _suffix(Path(path)), options.missing_frames == "bridge")
        super().__init__(path, self.frames.numbers)

    def scan(self, number: int) -> Scan | None:
        path = self.frames.paths[number]
        if path is None:
            return None
        mesh = read_mesh(path)
        polygons = mesh.polygons()
        if polygons is not None:
            polygons.check(path, len(mesh.points))
        return Scan(mesh.points, None if polygons is None else triangulated(polygons))


class MeshScans(ScanSequence):
    """The meshes of any clip that is read as a sequence of one topology, which need not be the rig's."""

    def __init__(self, sequence: MeshSequence) -> None:
        super().__init__(sequence.path, sequence.frame_numbers, sequence.fps, sequence.unit_mm, sequence.up)
        self.sequence = sequence
        self.faces = None if sequence.faces is None else triangulated(sequence.faces)

    def scan(self, number: int) -> Scan | None:
        return Scan(self.sequence.read(number, number + 1)[0], self.faces)


class RaggedArrays(ScanSequence):
    """An .npz of ragged arrays, frame after frame.

    It holds `points (point, 3)` and `offsets (frame + 1,)`: frame f has the points from offsets[f] up to offsets[f + 1]. Meshes
    have `faces (face, 3)`, which count within their frame, and `face_offsets (frame + 1,)`; point clouds may have `normals
    (point, 3)`. `fps` and `frame_numbers` as in other clips.
    """

    def __init__(self, path: Path) -> None:
        self.arrays = _load(path)
        points, offsets = self.arrays.get("points"), self.arrays.get("offsets")
        if points is None or offsets is None:
            raise InputError(f"{path}: scans need the arrays points and offsets, found {', '.join(self.arrays) or 'none'}")
        _check_floats(path, "points", points)
        _check_offsets(path, "offsets", offsets, len(points))
        frames = len(offsets) - 1
        if "faces" in self.arrays:
            faces, starts = self.arrays["faces"], self.arrays.get("face_offsets")
            if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or starts is None:
                raise InputError(
                    f"{path}: faces of scans are whole numbers (face, 3) with face_offsets (frame + 1,) beside them"
                )
            _check_offsets(path, "face_offsets", starts, len(faces), frames)
        if "normals" in self.arrays:
            _check_floats(path, "normals", self.arrays["normals"], len(points))
        numbers = self.arrays.get("frame_numbers", np.arange(frames))
        if numbers.shape != (frames,) or numbers.dtype.kind not in "iu" or (np.diff(numbers.astype(np.int64)) <= 0).any():
            raise InputError(f"{path}: frame_numbers are no {frames} whole numbers that rise")
        rate = self.arrays.get("fps")
        if rate is not None and (rate.size != 1 or rate.dtype.kind not in "iuf"):
            raise InputError(f"{path}: fps is {rate.dtype} of shape {rate.shape}, expected one number")
        super().__init__(path, numbers, None if rate is None else float(rate.reshape(-1)[0]))

    def scan(self, number: int) -> Scan | None:
        first, last = (int(value) for value in self.arrays["offsets"][number : number + 2])
        points = self.arrays["points"][first:last].astype(np.float32)
        normals = self.arrays.get("normals")
        if "faces" not in self.arrays:
            return Scan(points, None, None if normals is None else normals[first:last])
        start, stop = (int(value) for value in self.arrays["face_offsets"][number : number + 2])
        faces = self.arrays["faces"][start:stop].astype(np.int64)
        Polygons.triangles(faces).check(self.path, len(points))
        return Scan(points, faces)


def _suffix(given: Path) -> str:
    """The ending of a sequence's files; in a folder, the first of `SUFFIXES` that a file there has."""
    if given.is_dir():
        found = {file.suffix.lower() for file in visible_files(given)}
        return next((suffix for suffix in SUFFIXES if suffix in found), SUFFIXES[0])
    return given.suffix.lower()


def triangulated(polygons: Polygons) -> np.ndarray:
    """Triangles `(face, 3)` of polygons, as fans; those of fewer than three corners give none."""
    starts = np.cumsum(polygons.sizes) - polygons.sizes
    count = np.maximum(polygons.sizes - 2, 0)
    first = np.repeat(starts, count)
    along = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([polygons.corners[first + step] for step in (0 * along, along + 1, along + 2)], axis=1)


def _load(path: Path) -> dict[str, np.ndarray]:
    try:
        check_npz(path)
        with np.load(path, allow_pickle=False) as archive:
            wanted = ("points", "offsets", "faces", "face_offsets", "normals", "fps", "frame_numbers")
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
            f"{path}: {name} must rise from 0 to {last}, one more than there are frames; found shape {values.shape}"
        )
    if np.diff(values.astype(np.int64)).max() > MAX_VERTICES:
        raise InputError(f"{path}: a scan of more than {MAX_VERTICES} points: damaged; save it again")
