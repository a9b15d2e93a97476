"""Alembic and FBX clips, read by Blender in a worker process (`pip install 'riginv[blender]'`)."""

from pathlib import Path

from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.interpreter import find_interpreter, script_command
from rigs.worker_clip import Source, WorkerClip

TIMEOUT_S = 300.0  # for a chunk of frames, or for the import
FORMATS = {".abc": "Alembic", ".fbx": "FBX"}
BEGINNINGS = {".abc": (b"Ogawa", b"\x89HDF"), ".fbx": (b"Kaydara FBX Binary", b"; FBX")}


class BlenderClip(WorkerClip):
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

    def _source(self, path: str, options: ReadingOptions) -> Source:
        file = Path(path).expanduser().absolute()
        _check(path, file)
        command = script_command(find_interpreter(options.interpreter, "reading.interpreter"), "play.py")
        return Source(command, TIMEOUT_S, file, FORMATS[file.suffix.lower()])

    def _failure(self, error: Exception) -> str:
        text = " ".join(str(error).split())
        refused = isinstance(error, WorkerRefusedError) and Path(self.path).name in text
        return text if refused else f"{self.path}: Blender cannot read it: {text}"


def _check(path: str, file: Path) -> None:
    """Raises InputError where a file is missing or its content does not match its suffix."""
    if not file.is_file():
        raise InputError(f"{path}: no such file; clip=PATH names a clip")
    with file.open("rb") as opened:
        start = opened.read(24)
    if not start.startswith(BEGINNINGS[file.suffix.lower()]):
        raise InputError(f"{path}: this is no {file.suffix.lower()[1:]} file, or a damaged one: copy it or export it again")
