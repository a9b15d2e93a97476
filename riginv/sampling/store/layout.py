"""Layout of a store of poses.

controls              (pose, control) float32, in each control's unit
coefficients          (pose, coefficient) float32 or float16: the rig's own, or those of `basis`
vertices              (pose, vertex, 3) float32 or float16, mm; only where requested
control_range         (chunk, 2, control): least and greatest value of each control in each chunk
errors                (chunk, kind): errors of storage, of the kinds `ERRORS`
ledger                (chunk, 1 + array): number of poses of a chunk, 0 where absent, and a CRC-32C of each array above
neutral_coefficients  (coefficient,)
basis                 (coefficient, vertex, 3), mm: only of black-box rigs, whose basis is fitted

The row of the ledger is written last, so that a chunk is complete or absent; every stored block ends in its CRC-32C.
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
    "coefficient_greatest",  # rounding errors in the units of the coefficients, over all poses
    "coefficient_mean",
    "mesh_greatest_mm",  # vertex errors of rounded coefficients, over a few poses of each chunk
    "mesh_mean_mm",
    "vertices_greatest_mm",  # rounding errors of `vertices`, over all poses
    "vertices_mean_mm",
    "outside_mean_mm",  # root mean square distance from the span of a fitted basis, over all poses
)
CHUNK_BYTES, MOST_IN_CHUNK, MOST_OF_A_SLOW_RIG = 16e6, 4096, 512
CODECS = (ZstdCodec(level=1), Crc32cCodec())  # 45 % of the size and 20 % more time for the default face


@dataclass(frozen=True)
class ArrayPlan:
    """Shape, chunk shape, type and dimension names of an array."""

    shape: tuple[int, ...]
    chunk: tuple[int, ...]
    dtype: str
    dimensions: tuple[str, ...]

    def create_in(self, group: zarr.Group, name: str) -> zarr.Array:
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
        """Whether an array's metadata is exactly as planned."""
        fresh = self.create_in(zarr.group(MemoryStore()), "array")
        return _described(fresh) == _described(array)


def _described(array: zarr.Array) -> str:
    return json.dumps({**array.metadata.to_dict(), "attributes": {}}, sort_keys=True, default=str)


@dataclass(frozen=True)
class Layout:
    """The sizes of a store.

    Attributes:
        samples: number of poses.
        chunk: poses in a chunk; the last one may have fewer.
        dtype: of coefficients and vertices.
        controls, coefficients: numbers of the rig.
        vertices: number of vertices where they are stored, else 0.
        fitted: number of vertices where the basis was fitted to poses, else 0.
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
        """Names of the arrays with one row for each pose."""
        return (CONTROLS, COEFFICIENTS, *((VERTICES,) if self.vertices else ()))

    @property
    def checked(self) -> tuple[str, ...]:
        """Names of the arrays with a checksum in the ledger."""
        return (*self.poses, CONTROL_RANGE, COST)

    def rows(self, chunk: int) -> slice:
        """Poses of a chunk."""
        return slice(chunk * self.chunk, min((chunk + 1) * self.chunk, self.samples))

    def count(self, chunk: int) -> int:
        """Number of poses of a chunk."""
        rows = self.rows(chunk)
        return rows.stop - rows.start

    def slice_of(self, name: str, chunk: int) -> slice:
        """Rows of an array that belong to a chunk."""
        return self.rows(chunk) if name in self.poses else slice(chunk, chunk + 1)

    @property
    def bytes_per_pose(self) -> int:
        """Memory of a pose."""
        return 4 * self.controls + np.dtype(self.dtype).itemsize * (self.coefficients + 3 * self.vertices)

    def plans(self) -> dict[str, ArrayPlan]:
        """Plans of all arrays, by name."""
        poses, chunks = min(self.chunk, self.samples), self.chunks
        plans = {
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
            plans[VERTICES] = ArrayPlan(
                (self.samples, self.vertices, 3), (poses, self.vertices, 3), self.dtype, ("pose", "vertex", "axis")
            )
        if self.fitted:
            shape = (self.coefficients, self.fitted, 3)
            plans[BASIS] = ArrayPlan(shape, shape, "float32", ("coefficient", "vertex", "axis"))
        return plans

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def default_chunk(layout: Layout, slow: bool) -> int:
    """Default number of poses in a chunk: about 16 MB, fewer for slow rigs."""
    most = MOST_OF_A_SLOW_RIG if slow else MOST_IN_CHUNK
    return max(1, min(most, int(CHUNK_BYTES // layout.bytes_per_pose)))
