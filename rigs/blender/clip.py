"""Alembic and FBX clips, read by Blender in a worker process (`pip install 'riginv[blender]'`)."""

from pathlib import Path

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons, SourceFacts
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.interpreter import find_interpreter, script_command
from rigs.blender.pool import PoseLostError, WorkerPool

TIMEOUT_S = 300.0  # for a chunk of frames, or for the import
FORMATS = {".abc": "Alembic", ".fbx": "FBX"}
BEGINNINGS = {".abc": (b"Ogawa", b"\x89HDF"), ".fbx": (b"Kaydara FBX Binary", b"; FBX")}


class BlenderClip(MeshSequence):
    """Meshes of an .abc or .fbx, as Blender evaluates it; several are concatenated in the order of the scene.

    Args:
        path: of the file.
        options: `mesh`: names of mesh objects; None: the only mesh that moves, or what fits `vertices`. `animation`: name or
            number of a take of an FBX; None: the first that moves the meshes. `fps`: frame rate; None: the file's own.
            `interpreter`: a Python that has bpy, or Blender itself; None: see `find_interpreter`.
        vertices: number of vertices of the clip's rig, where known.

    Raises:
        InputError: no Blender, no such file, mesh or animation, or Blender cannot import it.
    """

    def __init__(self, path: str, options: ReadingOptions, vertices: int | None = None) -> None:
        file = Path(path).expanduser().absolute()
        _check(path, file)
        load = {
            "file": str(file),
            "meshes": options.mesh_names,
            "animation": options.animation,
            "fps": options.fps,
            "vertices": vertices,
        }
        self.pool = WorkerPool(script_command(find_interpreter(options.interpreter), "play.py"), load, 1, TIMEOUT_S)
        self.path = path
        try:
            facts, arrays = self.pool.describe()
        except (WorkerRefusedError, PoseLostError) as error:
            self.pool.close()
            raise self._failure(error) from None
        faces = Polygons(arrays["sizes"].astype(np.int64), arrays["corners"].astype(np.int64))
        super().__init__(
            path,
            arrays["frames"],
            facts["vertices"],
            faces if len(faces) else None,
            facts["fps"] or None,
            facts["unit_mm"] or None,
            "y",
            SourceFacts(
                FORMATS[file.suffix.lower()],
                tuple(facts["meshes"]),
                tuple(facts["other_meshes"]),
                facts["animation"],
                tuple(facts["other_animations"]),
                facts["rate_source"],
                tuple(facts["notes"]),
            ),
        )

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> "BlenderClip":
        """Open a clip of a rig, whose number of vertices selects the meshes unless the user names them.

        Raises:
            InputError: the file cannot be read, or it is not clear which meshes are meant.
        """
        return cls(path, options, None if options.vertices is not None else len(rig.rest_vertices))

    def read(self, start: int, stop: int) -> np.ndarray:
        try:
            return self.pool.evaluate(["frame"], np.arange(start, stop, dtype=np.float32)[:, None])
        except (WorkerRefusedError, PoseLostError) as error:
            raise self._failure(error) from None

    def _failure(self, error: Exception) -> InputError:
        text = " ".join(str(error).split())
        refused = isinstance(error, WorkerRefusedError) and Path(self.path).name in text
        return InputError(text if refused else f"{self.path}: Blender cannot read it: {text}")


def _check(path: str, file: Path) -> None:
    """Raises InputError where a file is missing or is not of the format that its name says."""
    if not file.is_file():
        raise InputError(f"{path}: no such file; clip=PATH names a clip")
    with file.open("rb") as opened:
        start = opened.read(24)
    if not start.startswith(BEGINNINGS[file.suffix.lower()]):
        raise InputError(f"{path}: this is no {file.suffix.lower()[1:]} file: it starts with {start[:8]!r}; export it again")
