"""USD point samples as clips (`pip install 'riginv[usd]'`): the points of a mesh at each time code, placed in the world."""

import importlib.util
import sys
from pathlib import Path

import numpy as np

from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.errors import InputError
from rigs.blender.pool import PoseLostError, WorkerPool
from rigs.blender.process import WorkerRefusedError

TIMEOUT_S = 120.0  # for a chunk of frames, or for opening the stage
SCRIPT = Path(__file__).parent / "play_usd.py"


class UsdClip(MeshSequence):
    """A mesh of a USD stage whose points have time samples.

    Args:
        path: the stage.
        options: `mesh`: the path or the name of its prim; None: the only one whose points move.

    Raises:
        InputError: usd-core is not installed, the stage cannot be opened, or no mesh, or more than one, could be meant.
    """

    def __init__(self, path: str, options: ReadingOptions) -> None:
        if importlib.util.find_spec("pxr") is None:
            raise InputError(f"{path}: reading USD needs usd-core: pip install 'riginv[usd]'")
        if not Path(path).is_file():
            raise InputError(f"{path}: no such file; clip=PATH names a clip")
        load = {"file": str(Path(path).absolute()), "mesh": options.mesh}
        self.path = path
        self.pool = WorkerPool([sys.executable, str(SCRIPT)], load, 1, TIMEOUT_S)
        try:
            facts, arrays = self.pool.describe()
        except (WorkerRefusedError, PoseLostError) as error:
            self.pool.close()
            raise self._failure(error) from None
        sizes, corners, times = arrays["sizes"], arrays["corners"], arrays["times"]
        if (sizes < 0).any() or sizes.sum() != len(corners):
            raise InputError(f"{path}: its faces need {sizes.sum()} corners and have {len(corners)}: export it again")
        step = float(np.diff(times).min()) if len(times) > 1 else 1.0
        numbers = np.round(times / step)
        if not np.abs(numbers).max() < 2**53:
            raise InputError(f"{path}: time codes {times[0]:g} to {times[-1]:g}, {step:g} apart: damaged; export it again")
        faces = Polygons(sizes, corners) if len(sizes) else None
        rate = facts["rate"] / step if facts["rate"] else None
        super().__init__(path, numbers, facts["vertices"], faces, rate, facts["unit_mm"], facts["up"])

    def read(self, start: int, stop: int) -> np.ndarray:
        try:
            vertices = self.pool.evaluate(["frame"], np.arange(start, stop, dtype=np.float32)[:, None])
        except (WorkerRefusedError, PoseLostError) as error:
            raise self._failure(error) from None
        except ValueError:
            raise InputError(f"{self.path}: its frames have different numbers of points: all must be the same mesh") from None
        if vertices.shape[1] != self.vertex_count:
            raise InputError(
                f"{self.path}: {vertices.shape[1]} points in a frame, and {self.vertex_count} at first: mixed meshes"
            )
        return vertices

    def _failure(self, error: Exception) -> InputError:
        said = (
            str(error) if isinstance(error, WorkerRefusedError) else f"{self.path}: the process that reads USD is lost: {error}"
        )
        return InputError(" ".join(said.split()))
