"""USD stages as clips, with skeletons, blend shapes, time samples and transforms (`pip install 'riginv[usd]'`)."""

import importlib.util
import sys
from pathlib import Path

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons, SourceFacts
from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.pool import PoseLostError, WorkerPool

TIMEOUT_S = 120.0  # for a chunk of frames, or for opening the stage
SCRIPT = Path(__file__).parent / "play_usd.py"


class UsdClip(MeshSequence):
    """Meshes of a USD stage in world space, frame by frame; several are concatenated in the stage's order.

    Args:
        path: the stage.
        options: `mesh`: paths or names; None: the only mesh that moves, or what fits `vertices`. `animation`: path, name or
            number of a SkelAnimation; None: the bound one. `fps`: frame rate, where samples lie between whole time codes.
        vertices: number of vertices of the clip's rig, where known.

    Raises:
        InputError: usd-core is not installed, the stage cannot be opened, or the choice of meshes is ambiguous.
    """

    def __init__(self, path: str, options: ReadingOptions, vertices: int | None = None) -> None:
        if importlib.util.find_spec("pxr") is None:
            raise InputError(f"{path}: reading USD needs usd-core: pip install 'riginv[usd]'")
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; clip=PATH names a clip")
        load = {
            "file": str(Path(path).absolute()),
            "meshes": options.mesh_names,
            "animation": options.animation,
            "fps": options.fps,
            "vertices": vertices,
        }
        self.path = path
        self.pool = WorkerPool([sys.executable, str(SCRIPT)], load, 1, TIMEOUT_S)
        try:
            facts, arrays = self.pool.describe()
        except (WorkerRefusedError, PoseLostError) as error:
            self.pool.close()
            raise self._failure(error) from None
        sizes, corners = arrays["sizes"], arrays["corners"]
        if (sizes < 0).any() or sizes.sum() != len(corners):
            raise InputError(f"{path}: its faces need {sizes.sum()} corners and have {len(corners)}: export it again")
        super().__init__(
            path,
            arrays["numbers"],
            facts["vertices"],
            Polygons(sizes, corners) if len(sizes) else None,
            facts["rate"],
            facts["unit_mm"],
            facts["up"],
            SourceFacts(
                "USD",
                tuple(facts["meshes"]),
                tuple(facts["other_meshes"]),
                facts["animation"],
                tuple(facts["other_animations"]),
                facts["rate_source"],
                tuple(facts["notes"]),
            ),
        )

    @classmethod
    def for_rig(cls, path: str, options: ReadingOptions, rig: RigBackend) -> "UsdClip":
        """Open a clip of a rig, whose number of vertices selects the meshes unless the user names them.

        Raises:
            InputError: the stage cannot be read, or it is not clear which meshes are meant.
        """
        return cls(path, options, None if options.vertices is not None else len(rig.rest_vertices))

    def read(self, start: int, stop: int) -> np.ndarray:
        try:
            return self.pool.evaluate(["frame"], np.arange(start, stop, dtype=np.float32)[:, None])
        except (WorkerRefusedError, PoseLostError) as error:
            raise self._failure(error) from None

    def _failure(self, error: Exception) -> InputError:
        text = (
            str(error) if isinstance(error, WorkerRefusedError) else f"{self.path}: the process that reads USD is lost: {error}"
        )
        return InputError(" ".join(text.split()))
