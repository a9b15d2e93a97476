"""USD stages as clips, with skeletons, blend shapes, time samples and transforms (`pip install 'riginv[usd]'`)."""

import contextlib
import importlib.util
import sys
from pathlib import Path

from riginv.clips.bones import JointNamesError
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.runs.worker_process import WorkerRefusedError
from rigs.usd.bones import bones_clip
from rigs.worker_clip import Source, WorkerClip

TIMEOUT_S = 120.0  # for a chunk of frames, or for opening the stage
SCRIPT = Path(__file__).parent / "play_usd.py"


class UsdClip(WorkerClip):
    """Meshes of a USD stage in world space, frame by frame; several are concatenated in the stage's order.

    Args:
        path: the stage.
        options: `mesh`: paths or names; None: the only mesh that moves, or what fits `vertices`. `animation`: path, name or
            number of a SkelAnimation; None: the bound one. `fps`: frame rate, where samples lie between whole time codes.
        vertices: number of vertices of the clip's rig, where known.

    Raises:
        InputError: usd-core is not installed, the stage cannot be opened, or the choice of meshes is ambiguous.
    """

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> MeshSequence:
        """A clip of the rig's mesh, or else of its joints, which a skeleton of the stage moves.

        Raises:
            InputError: the file cannot be read, or it is not clear which meshes, skeleton or animation is meant.
        """
        try:
            clip = super().for_rig(path, options, rig)
        except InputError:
            bones = _bones(path, options, rig)
            if bones is None:
                raise
            return bones
        if clip.vertex_count == len(rig.rest_vertices):
            return clip
        with contextlib.suppress(JointNamesError):  # as a clip of meshes it is refused with what it lacks
            return _bones(path, options, rig) or clip
        return clip

    def _source(self, path: str, options: ReadingOptions) -> Source:
        if importlib.util.find_spec("pxr") is None:
            raise InputError(f"{path}: reading USD needs usd-core: pip install 'riginv[usd]'")
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; clip=PATH names a clip")
        return Source([sys.executable, str(SCRIPT)], TIMEOUT_S, Path(path).absolute(), "USD")

    def _failure(self, error: Exception) -> str:
        text = (
            str(error) if isinstance(error, WorkerRefusedError) else f"{self.path}: the process that reads USD is lost: {error}"
        )
        return " ".join(text.split())


def _bones(path: str, options: ReadingOptions, rig: RigBackend) -> MeshSequence | None:
    """The stage as a clip of the rig's joints; None where it cannot be one."""
    of_meshes = options.mesh_names or options.vertices is not None or rig.skeleton() is None
    if of_meshes or importlib.util.find_spec("pxr") is None or not Path(path).is_file():
        return None
    return bones_clip(path, options, rig, TIMEOUT_S)
