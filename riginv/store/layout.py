"""What a store of poses holds, and how it is cut into chunks.

controls              (pose, control) float32, in each control's unit
coefficients          (pose, coefficient) float32 or float16: the rig's own, or of a fitted rig those of `basis`
vertices              (pose, vertex, 3) float32 or float16, mm; only where they were asked for
control_range         (chunk, 2, control): the least and the greatest value of each control in each chunk
errors                (chunk, kind): what storing cost, by the kinds of `ERRORS`
ledger                (chunk, 1 + array): the poses of a chunk, 0 where it is absent, and a CRC-32C of each of the arrays above
neutral_coefficients  (coefficient,)
basis                 (coefficient, vertex, 3), mm: only of a fitted rig

A row of the ledger is written last, so that a chunk is complete or absent; every stored piece ends in a CRC-32C of its own.
"""

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import zarr
from zarr.codecs import Crc32cCodec, ZstdCodec
from zarr.storage import MemoryStore

FORMAT = 1
CONTROLS, COEFFICIENTS, VERTICES = "controls", "coefficients", "vertices"
CONTROL_RANGE, LEDGER, NEUTRAL, BASIS = "control_range", "ledger", "neutral_coefficients", "basis"
COST = "errors"
ERRORS = (
    "coefficient_greatest",  # of rounding, in the units of the coefficients: over all poses
    "coefficient_mean",
    "mesh_greatest_mm",  # of rounding the coefficients, in distances of vertices: over a few poses of each chunk
    "mesh_mean_mm",
    "vertices_greatest_mm",  # of rounding `vertices`: over all poses
    "vertices_mean_mm",
    "outside_mean_mm",  # between a fitted rig's meshes and those of its coefficients, root mean square: over all poses
)
DTYPES = ("float32", "float16")
CHUNK_BYTES, MOST_IN_CHUNK, MOST_OF_A_SLOW_RIG = 16e6, 4096, 512
CODECS = (ZstdCodec(level=1), Crc32cCodec())  # of the face: 45 % of the size, for a fifth more time


@dataclass(frozen=True)
class ArrayPlan:
    """One array of a store: its shape, that of its chunks, and what its dimensions are."""

    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    dtype: str
    dimensions: tuple[str, ...]

    def create_in(self, group: zarr.Group, name: str) -> zarr.Array:
        """Make the array, empty."""
        return group.create_array(
            name,
            shape=self.shape,
            chunks=self.chunk,
            dtype=self.dtype,
            fill_value=0 if self.dtype == "uint32" else float("nan"),
            compressors=CODECS,
            dimension_names=self.dimensions,
        )

    def describes(self, array: zarr.Array) -> bool:
        """Whether an array is as planned, to the last word of its description."""
        fresh = self.create_in(zarr.group(MemoryStore()), "array")
        return _described(fresh) == _described(array)


def _described(array: zarr.Array) -> str:
    return json.dumps({**array.metadata.to_dict(), "attributes": {}}, sort_keys=True, default=str)


@dataclass(frozen=True)
class Layout:
    """The sizes of a store.

    Attributes:
        samples: poses in all.
        chunk: poses in a chunk; the last one may have fewer.
        dtype: of coefficients and vertices.
        controls, coefficients: of the rig.
        vertices: of the rig where they are stored, else 0.
        fitted: vertices of the rig where it has a basis that was fitted to its poses, else 0.
    """

    samples: int
    chunk: int
    dtype: str
    controls: int
    coefficients: int
    vertices: int = 0
    fitted: int = 0

    @property
    def chunks(self) -> int:
        return -(-self.samples // self.chunk)

    @property
    def poses(self) -> tuple[str, ...]:
        """The names of the arrays that hold one row for each pose."""
        return (CONTROLS, COEFFICIENTS, *((VERTICES,) if self.vertices else ()))

    @property
    def checked(self) -> tuple[str, ...]:
        """The names of the arrays that the ledger has a checksum of."""
        return (*self.poses, CONTROL_RANGE, COST)

    def rows(self, chunk: int) -> slice:
        """The poses of a chunk."""
        return slice(chunk * self.chunk, min((chunk + 1) * self.chunk, self.samples))

    def count(self, chunk: int) -> int:
        """How many they are."""
        rows = self.rows(chunk)
        return rows.stop - rows.start

    def place(self, name: str, chunk: int) -> slice:
        """Where an array holds what belongs to a chunk."""
        return self.rows(chunk) if name in self.poses else slice(chunk, chunk + 1)

    @property
    def bytes_per_pose(self) -> int:
        """Of a pose in memory."""
        return 4 * self.controls + np.dtype(self.dtype).itemsize * (self.coefficients + 3 * self.vertices)

    def plans(self) -> dict[str, ArrayPlan]:
        """Every array, by name."""
        poses, chunks = min(self.chunk, self.samples), self.chunks
        found = {
            CONTROLS: ArrayPlan((self.samples, self.controls), (poses, self.controls), "float32", ("pose", "control")),
            COEFFICIENTS: ArrayPlan(
                (self.samples, self.coefficients), (poses, self.coefficients), self.dtype, ("pose", "coefficient")
            ),
            CONTROL_RANGE: ArrayPlan(
                (chunks, 2, self.controls), (1, 2, self.controls), "float32", ("chunk", "least_greatest", "control")
            ),
            COST: ArrayPlan((chunks, len(ERRORS)), (1, len(ERRORS)), "float32", ("chunk", "kind")),
            LEDGER: ArrayPlan(
                (chunks, 1 + len(self.checked)), (1, 1 + len(self.checked)), "uint32", ("chunk", "poses_and_checksums")
            ),
            NEUTRAL: ArrayPlan((self.coefficients,), (self.coefficients,), "float32", ("coefficient",)),
        }
        if self.vertices:
            shape = (self.vertices, 3)
            found[VERTICES] = ArrayPlan((self.samples, *shape), (poses, *shape), self.dtype, ("pose", "vertex", "axis"))
        if self.fitted:
            shape = (self.coefficients, self.fitted, 3)
            found[BASIS] = ArrayPlan(shape, shape, "float32", ("coefficient", "vertex", "axis"))
        return found

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def default_chunk(layout: Layout, slow: bool) -> int:
    """Poses in a chunk where nobody said: about 16 MB, and of a slow rig what it makes in seconds."""
    most = MOST_OF_A_SLOW_RIG if slow else MOST_IN_CHUNK
    return max(1, min(most, int(CHUNK_BYTES // layout.bytes_per_pose)))
