"""USD stages as clips, with skeletons, blend shapes, time samples and transforms (`pip install 'riginv[usd]'`)."""

import importlib.util
import sys
from pathlib import Path

from riginv.clips.options import ReadingOptions
from riginv.errors import InputError
from riginv.runs.worker_process import WorkerRefusedError
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

    def _source(self, path: str, options: ReadingOptions) -> Source:
        if importlib.util.find_spec("pxr") is None:
            raise InputError(f"{path}: reading USD needs usd-core: pip install 'riginv[usd]'")
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; clip=PATH names a clip")
        return Source([sys.executable, str(SCRIPT)], TIMEOUT_S, Path(path).absolute(), "USD")

    def _failure(self, error: Exception) -> InputError:
        text = (
            str(error) if isinstance(error, WorkerRefusedError) else f"{self.path}: the process that reads USD is lost: {error}"
        )
        return InputError(" ".join(text.split()))
