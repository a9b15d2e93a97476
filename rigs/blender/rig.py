"""A .blend file as a black-box rig that Blender evaluates."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from riginv.errors import InputError, listed
from riginv.rig.arkit import ArkitParts
from riginv.rig.interface import Control, Motion, RigBackend
from riginv.runs.worker_pool import GROWTH_MB
from riginv.runs.worker_process import WorkerRefusedError
from rigs.blender.interpreter import find_interpreter, script_command
from rigs.blender.pool import PoseLostError, WorkerPool
from rigs.blender.selection import Selection, select
from rigs.blender.twin import twin_file

BEGINNINGS = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")  # uncompressed, Zstandard, gzip


class BlenderRig(RigBackend):
    """A mesh of a .blend, evaluated by Blender with all its modifiers: world space, mm, y up.

    Args:
        file: the .blend; None: that of `twin_of`.
        mesh: the name of the mesh object; None: the only one.
        include, exclude, rename, bounds: selection of controls, see `Selection`.
        workers: most processes; None: one for each CPU core, up to 8.
        interpreter: a Python that has bpy, or Blender itself; None: see `find_interpreter`.
        timeout_s: longest time for a batch of poses.
        growth_mb: growth of a worker's memory after its first poses at which it is replaced; None: never.
        scripts: allow Python of the .blend to run.
        twin_of: rig that is exported to Blender and evaluated there.

    Raises:
        InputError: no Blender, no such file or mesh, or nothing that moves it.
    """

    differentiable = False
    # Ignored in bundles, which are untrusted:
    command_line_only: ClassVar[tuple[str, ...]] = (
        "interpreter",
        "scripts",
        "workers",
        "timeout_s",
    )

    def __init__(
        self,
        file: str | None = None,
        mesh: str | None = None,
        include: Sequence[str] = (),
        exclude: Sequence[str] = (),
        rename: Mapping[str, str] | None = None,
        bounds: Mapping[str, Sequence[float]] | None = None,
        workers: int | None = None,
        interpreter: str | None = None,
        timeout_s: float = 120.0,
        growth_mb: float | None = GROWTH_MB,
        scripts: bool = False,
        twin_of: RigBackend | None = None,
    ) -> None:
        if workers is not None and workers < 1:
            raise InputError(f"rig.workers is {workers}, expected at least 1")
        if not timeout_s > 0:
            raise InputError(f"rig.timeout_s is {timeout_s}, expected seconds above 0")
        if growth_mb is not None and not growth_mb > 0:
            raise InputError(f"rig.growth_mb is {growth_mb}, expected megabytes above 0, or null")
        program = find_interpreter(interpreter)
        if file is not None:
            path, name = _checked(file), Path(file).stem
        elif twin_of is not None:
            path, name = twin_file(twin_of, program), f"{twin_of.name} in Blender"
        else:
            raise InputError("rig.file must be given: the .blend that holds the rig")
        load = {"file": str(path), "mesh": mesh, "scripts": scripts}
        command, workers = script_command(program, "worker.py"), workers or min(os.cpu_count() or 1, 8)
        pool = WorkerPool(command, load, workers, timeout_s, growth_mb=growth_mb)
        try:
            header, arrays = pool.describe()
        except (WorkerRefusedError, PoseLostError) as error:
            pool.close()
            raise InputError(str(error) if isinstance(error, WorkerRefusedError) else f"{path}: {error}") from None
        found = [Control(**control) for control in header["controls"]]
        self.found_names, controls = select(found, Selection(include, exclude, rename, bounds), str(path))
        super().__init__(name, controls, *(torch.from_numpy(arrays[key].copy()) for key in ("rest_vertices", "faces")))
        self.pool = pool
        self._twin_of = (twin_of,) if file is None and twin_of is not None else ()  # in a tuple: not a submodule

    @torch.no_grad()
    def forward(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to vertices `(batch, vertex, 3)`, mm.

        Raises:
            InputError: Blender cannot evaluate a pose, or repeatedly crashes or hangs on it.
        """
        values = controls.detach().to("cpu", torch.float32)
        try:
            vertices = self.pool.evaluate(self.found_names, values.numpy())
        except WorkerRefusedError as error:
            raise InputError(str(error)) from None
        except PoseLostError as error:
            row = values[error.row or 0]
            moved = (row != self.neutral_controls.cpu()).nonzero()[:, 0].tolist() if error.row is not None else []
            pose = listed(f"{self.control_names[control]} {float(row[control]):g}" for control in moved)
            raise InputError(f"{self.name}: {error}; what it moves: {pose}") from None
        return torch.from_numpy(np.ascontiguousarray(vertices)).to(controls)

    def arkit_parts(self) -> dict[str, ArkitParts]:
        return {name: parts for rig in self._twin_of for name, parts in rig.arkit_parts().items()}

    def arkit_deltas(self) -> dict[str, Tensor]:
        return {name: deltas for rig in self._twin_of for name, deltas in rig.arkit_deltas().items()}

    def expressions(self) -> dict[str, dict[str, float]]:
        return {name: pose for rig in self._twin_of for name, pose in rig.expressions().items()}

    def motion(self) -> Motion | None:
        return next((rig.motion() for rig in self._twin_of), None)

    def vertex_colors(self) -> Tensor | None:
        return next((rig.vertex_colors() for rig in self._twin_of), None)


def _checked(file: str) -> Path:
    path = Path(file).expanduser().absolute()
    if not path.is_file():
        raise InputError(f"{file}: no such file; rig.file names a .blend")
    with path.open("rb") as opened:
        if not opened.read(16).startswith(BEGINNINGS):
            raise InputError(f"{file}: this is no .blend file")
    return path
