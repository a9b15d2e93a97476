"""Alembic and FBX as clips: Blender reads them, in a process of its own (`pip install 'riginv[blender]'`)."""

from pathlib import Path

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.clips.units import DEFAULT_FPS
from riginv.errors import InputError
from rigs.blender.interpreter import find_interpreter, script_command
from rigs.blender.pool import PoseLostError, WorkerPool
from rigs.blender.process import WorkerRefusedError

TIMEOUT_S = 300.0  # for a chunk of frames, or for the import
BEGINNINGS = {".abc": (b"Ogawa", b"\x89HDF"), ".fbx": (b"Kaydara FBX Binary", b"; FBX")}


class BlenderClip(MeshSequence):
    """A mesh of an .abc or .fbx, as Blender plays it.

    Args:
        path: of the file.
        options: `mesh`: the name of the mesh object; None: the only one. `fps`: at which an Alembic file, which does not say,
            is played; None: 30. `interpreter`: a Python that has bpy, or Blender itself; None: see `find_interpreter`.

    Raises:
        InputError: no Blender, no such file or mesh, or Blender cannot import it.
    """

    def __init__(self, path: str, options: ReadingOptions) -> None:
        file = Path(path).expanduser().absolute()
        _check(path, file)
        load = {"file": str(file), "mesh": options.mesh, "fps": float(options.fps or DEFAULT_FPS)}
        self.pool = WorkerPool(script_command(find_interpreter(options.interpreter), "play.py"), load, 1, TIMEOUT_S)
        self.path = path
        try:
            facts, arrays = self.pool.describe()
        except (WorkerRefusedError, PoseLostError) as error:
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
        )

    def read(self, start: int, stop: int) -> np.ndarray:
        numbers = self.frame_numbers[start:stop].astype(np.float32)[:, None]
        try:
            vertices = self.pool.evaluate(["frame"], numbers)
        except (WorkerRefusedError, PoseLostError) as error:
            raise self._failure(error) from None
        except ValueError:
            raise InputError(
                f"{self.path}: its meshes have different numbers of vertices: all frames must be the same mesh"
            ) from None
        if vertices.shape[1] != self.vertex_count:
            raise InputError(
                f"{self.path}: {vertices.shape[1]} vertices in frame {start}, {self.vertex_count} at first: mixed meshes"
            )
        return vertices

    def _failure(self, error: Exception) -> InputError:
        said = str(error)
        return InputError(said if isinstance(error, WorkerRefusedError) else f"{self.path}: Blender cannot read it: {said}")


def _check(path: str, file: Path) -> None:
    """That a file is there and begins as its name says."""
    if not file.is_file():
        raise InputError(f"{path}: no such file; clip=PATH names a clip")
    with file.open("rb") as opened:
        start = opened.read(24)
    if not start.startswith(BEGINNINGS[file.suffix.lower()]):
        raise InputError(f"{path}: this is no {file.suffix.lower()[1:]} file: it starts with {start[:8]!r}; export it again")
