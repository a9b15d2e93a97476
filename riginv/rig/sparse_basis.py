"""A basis of displacements most of which is 0, as blocks that kernels read, on a CPU in float32."""

from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.distances import FrameDistances
from riginv.geometry.kernels.library import Kernels, kernels, kernels_for
from riginv.runs.huge_pages import in_huge_pages
from riginv.runs.threads import workers

GROUP, BLOCK, TILE = 16, 8, 8  # vertices that are read together, rows and meshes that are multiplied together, as in the kernel
ZERO = 1e-9  # of a row of length 1: what counts as 0
MIN_NUMBERS = 1_000_000  # of a basis: below it there is nothing to gain
MAX_DENSITY = 0.5  # of the groups: above it nothing is gained
SKETCH, PASSES = 48, 6  # numbers of a vertex, and steps of the power iteration, that tell how vertices differ
MESHES_OF_THREAD = 16  # at least


class SparseBasis:
    """Products of meshes with the rows of a basis, and the meshes that the rows make.

    Vertices that the same rows move are put into groups; for each group only those rows are kept that move one of it.

    Args:
        basis: `(row, vertex, 3)`.
        used: whether each row moves a vertex of each group, `(group, row)`.
        members: the vertices of each group, `(group, 16)`; -1 where there are no more.
    """

    def __init__(self, basis: Float[Tensor, "row vertex 3"], used: Tensor, members: Tensor) -> None:
        self.rows, self.groups, self.members = len(basis), len(members), members.int()
        counts = used.sum(dim=1)
        starts = torch.nn.functional.pad((-(-counts // BLOCK) * BLOCK).cumsum(dim=0), (1, 0))
        group, row = used.nonzero().unbind(dim=1)
        index = starts[group] + torch.arange(len(row)) - (counts.cumsum(dim=0) - counts)[group]
        self.starts = starts.int()
        self.row = torch.full((int(starts[-1]),), self.rows, dtype=torch.int32).index_copy_(0, index, row.int())
        vertex = members[group]
        moved = basis.flatten(0, 1).index_select(0, (row[:, None] * basis.shape[1] + vertex.clamp_min(0)).flatten())
        moved = (moved.unflatten(0, vertex.shape) * (vertex >= 0)[:, :, None]).flatten(1)
        blocks = basis.new_zeros(len(self.row), 3 * GROUP).index_copy_(0, index, moved)
        self.values = in_huge_pages([blocks.unflatten(0, (-1, BLOCK)).transpose(1, 2)])[0].flatten()  # eight rows after eight

    @classmethod
    def of(cls, basis: Float[Tensor, "row vertex 3"]) -> "SparseBasis | None":
        """None where a basis is small or not sparse, or there are no kernels for it."""
        if kernels_for(basis) is None or basis.dtype != torch.float32 or basis.numel() < MIN_NUMBERS:
            return None
        moves = basis.abs().amax(dim=2) > ZERO * basis.flatten(1).norm(dim=1, keepdim=True)
        if float(moves.float().mean()) > MAX_DENSITY:
            return None
        generator = torch.Generator().manual_seed(0)
        moved_by = moves.T.float() @ torch.randn(len(moves), SKETCH, generator=generator)  # keeps how much vertices differ
        vertices = torch.from_numpy(_alike(moved_by.numpy(), np.arange(basis.shape[1])))
        members = torch.nn.functional.pad(vertices, (0, -len(vertices) % GROUP), value=-1).unflatten(0, (-1, GROUP))
        used = (moves[:, members.clamp_min(0)] & (members >= 0)).any(dim=2).T
        return None if float(used.float().mean()) > MAX_DENSITY else cls(basis, used, members)

    def vertices(
        self, rest: Float[Tensor, "vertex 3"], coefficients: Float[Tensor, "batch row"]
    ) -> Float[Tensor, "batch vertex 3"]:
        """The meshes `(batch, vertex, 3)`: the rest mesh and the rows by their coefficients, as `apply_deltas`."""
        found = rest.new_empty(len(coefficients), *rest.shape)
        given = rest.contiguous(), rest.numel(), *self._layout(), self._padded(coefficients), found, len(found)
        _compiled().call("decode", torch.float32, *given)
        return found

    def products(
        self, rest: Float[Tensor, "vertex 3"], vertices: Float[Tensor, "batch vertex 3"], motion: Tensor | None = None
    ) -> Float[Tensor, "batch row"]:
        """The products `(batch, row)` of the displacements of meshes `(batch, vertex, 3)` with the rows, in float64.

        Args:
            rest: the rest mesh.
            motion: `(batch, 4, 4)`, which is removed from the meshes first; None: there is none.
        """
        size = max(MESHES_OF_THREAD, -(-len(vertices) // 2))
        motions = [None] * 2 if motion is None else motion.split(size)
        parts = zip(vertices.split(size), motions)
        return torch.cat(workers().run([partial(self._multiply, rest, *part) for part in parts]))

    def compare(
        self,
        rest: Float[Tensor, "vertex 3"],
        vertices: Float[Tensor, "batch vertex 3"],
        motion: Tensor | None,
        coefficients: Float[Tensor, "batch coefficient"],
    ) -> tuple[Tensor, FrameDistances, FrameDistances]:
        """As `products`, and the distances of the meshes from those of a rig and from the rest mesh, in one pass.

        Args:
            coefficients: of the rig's meshes, as differences from the neutral ones.

        Returns:
            the products, the distances from the rig's meshes, and those from the rest mesh, whose `worst` and `vertex` are
            0. `known` is the number of vertices that are finite; where it is not all of them nothing else is meaningful.
        """
        count = len(vertices)
        tiles, rows = self._tiles(count), torch.empty(-(-count // TILE), 7, TILE, dtype=torch.float64)
        given = self._given(rest, vertices, motion)
        _compiled().call("compare", torch.float32, *given, self._padded(coefficients), tiles, rows, count)
        known, total, square, vertex, squares, rest_total, rest_squares = rows.transpose(0, 1).flatten(1)[:, :count]
        size = vertices.shape[1]
        distances = FrameDistances(
            known.long(), (total / size).float(), square.clamp_min(0).sqrt().float(), vertex.long(), squares
        )
        zeros = torch.zeros_like(distances.vertex)
        neutral = FrameDistances(known.long(), (rest_total / size).float(), zeros.float(), zeros, rest_squares)
        return self._of_tiles(tiles, count), distances, neutral

    def _multiply(self, rest: Tensor, vertices: Tensor, motion: Tensor | None) -> Tensor:
        tiles = self._tiles(len(vertices))
        _compiled().call("encode", torch.float32, *self._given(rest, vertices, motion), tiles, len(vertices))
        return self._of_tiles(tiles, len(vertices))

    def _given(self, rest: Tensor, vertices: Tensor, motion: Tensor | None) -> tuple[Tensor | int | None, ...]:
        """The arguments that the kernels have in common."""
        motion = None if motion is None else motion.contiguous()
        return vertices.detach().contiguous(), rest.contiguous(), rest.numel(), motion, *self._layout()

    def _layout(self) -> tuple[Tensor | int, ...]:
        return self.members, self.groups, self.starts, self.row, self.values, self.rows

    def _padded(self, coefficients: Tensor) -> Tensor:
        """Coefficients `(batch, row)` in tiles of meshes `(tile, row + 1, 8)`; 0 in the last row and for missing meshes."""
        padded = torch.nn.functional.pad(coefficients, (0, 1, 0, -len(coefficients) % TILE))
        return padded.unflatten(0, (-1, TILE)).transpose(1, 2).contiguous()

    def _tiles(self, count: int) -> Tensor:
        return torch.empty(-(-count // TILE), self.rows + 1, TILE, dtype=torch.float64)

    def _of_tiles(self, tiles: Tensor, count: int) -> Tensor:
        return tiles.transpose(1, 2).flatten(0, 1)[:count, :-1]


def _compiled() -> Kernels:
    found = kernels()
    assert found is not None
    return found


def _alike(moved_by: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Vertices `(vertex,)` in order of what moves them `(vertex, number)`: halved where they differ most, again and again."""
    if len(vertices) <= GROUP:
        return vertices
    here = moved_by[vertices]
    here = here - here.mean(axis=0)
    direction = np.ones(here.shape[1], here.dtype)
    for _ in range(PASSES):
        direction = here.T @ (here @ direction) + 1e-6 * direction
        direction /= max(float(np.abs(direction).max()), 1e-30)
    order = vertices[(here @ direction).argsort(kind="stable")]
    half = -(-len(order) // (2 * GROUP)) * GROUP
    return np.concatenate([_alike(moved_by, order[:half]), _alike(moved_by, order[half:])])
