"""Mesh coordinates by way of the products of a mesh with the rig's basis, most of which is 0, on a CPU.

With the basis B = M Q, Q the orthonormal directions of the mesh space, the coordinates Q d of a displacement d are M^+ (B d).
"""

from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.kernels.library import kernels, kernels_for
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.threads import workers

GROUP, BLOCK, TILE = 16, 8, 8  # vertices that are read together, rows and meshes that are multiplied together, as in the kernel
ZERO = 1e-9  # of a row of length 1: what counts as 0
MIN_NUMBERS = 1_000_000  # of a space's directions: below it there is nothing to gain
MAX_DENSITY = 0.5  # of the groups: above it nothing is gained
SKETCH, PASSES = 48, 6  # numbers of a vertex, and steps of the power iteration, that tell how vertices differ
MESHES_OF_THREAD = 16  # at least
PROBES, TOLERANCE = 8, 2e-5  # random meshes, and how far their coordinates may be from the dense ones, of their size


class SparseEncoder:
    """As `MeshSpace.encode`, several times as fast, on a CPU in float32.

    Vertices that the same shapes move are put into groups; for each group only those shapes are kept that move one of it.

    Args:
        rig: in mesh space.
        moves: whether each row moves each vertex, `(row, vertex)`.
        groups: the vertices of each group.
    """

    def __init__(self, rig: RigInMeshSpace, moves: Tensor, groups: list[Tensor]) -> None:
        basis = rig.source.basis
        self.rows, self.groups = len(basis), len(groups)
        members = torch.stack([torch.nn.functional.pad(group, (0, GROUP - len(group)), value=-1) for group in groups])
        used = [moves[:, group].any(dim=1).nonzero()[:, 0] for group in groups]
        padded = [torch.nn.functional.pad(rows, (0, -len(rows) % BLOCK), value=self.rows) for rows in used]
        blocks = [_blocks(basis, rows, group) for rows, group in zip(padded, members)]
        self.members, self.row, self.values = members.int(), torch.cat(padded).int(), torch.cat(blocks)
        self.starts = torch.tensor([0, *(len(rows) for rows in padded)]).cumsum(dim=0).int()
        directions = rig.space.directions  # which the basis spans: the products are of full column rank
        left, upper = torch.linalg.qr(self._products(torch.zeros_like(directions[0]), directions, None).T)
        self.matrix = torch.linalg.solve_triangular(upper, left.T, upper=True).T.contiguous()

    @classmethod
    def for_rig(cls, rig: RigInMeshSpace) -> "SparseEncoder | None":
        """None where a rig's basis is small or not sparse, does not span the space, or there are no kernels for it.

        Nor for rigs without blendshapes, which may move by metres: the tolerance is relative to that.
        """
        directions, basis = rig.space.directions, rig.source.basis
        if kernels_for(directions, basis) is None or basis.dtype != torch.float32:
            return None
        if not rig.source.has_blendshapes or directions.numel() < MIN_NUMBERS or len(basis) < len(directions):
            return None
        moves = basis.abs().amax(dim=2) > ZERO * basis.flatten(1).norm(dim=1, keepdim=True)
        if float(moves.float().mean()) > MAX_DENSITY:
            return None
        generator = torch.Generator().manual_seed(0)
        moved_by = moves.T.float() @ torch.randn(len(moves), SKETCH, generator=generator)  # keeps how much vertices differ
        groups = _alike(moved_by, torch.arange(basis.shape[1]))
        if sum(int(moves[:, group].any(dim=1).sum()) * GROUP for group in groups) > MAX_DENSITY * moves.numel():
            return None
        found = cls(rig, moves, groups)
        meshes = rig.space.rest_vertices + torch.randn(PROBES, *basis.shape[1:], generator=generator)
        apart = (found(rig.space.rest_vertices, meshes) - rig.space.encode(meshes)).norm(dim=1)
        size = (meshes - rig.space.rest_vertices).flatten(1).norm(dim=1)
        return found if bool((apart <= TOLERANCE * size).all()) else None

    def __call__(
        self, rest: Float[Tensor, "vertex 3"], vertices: Float[Tensor, "batch vertex 3"], motion: Tensor | None = None
    ) -> Float[Tensor, "batch coordinate"]:
        """Meshes `(batch, vertex, 3)`, mm, to mesh coordinates.

        Args:
            rest: the rest mesh.
            motion: `(batch, 4, 4)`, which is removed from the meshes first; None: there is none.
        """
        return (self._products(rest, vertices, motion) @ self.matrix).float()

    def _products(self, rest: Tensor, vertices: Tensor, motion: Tensor | None) -> Tensor:
        """The products `(batch, row)` of displacements with the basis, in float64."""
        size = max(MESHES_OF_THREAD, -(-len(vertices) // 2))
        motions = [None] * 2 if motion is None else motion.split(size)
        parts = zip(vertices.split(size), motions)
        return torch.cat(workers().run([partial(self._multiply, rest, *part) for part in parts]))

    def _multiply(self, rest: Tensor, vertices: Tensor, motion: Tensor | None) -> Tensor:
        tiles = torch.empty(-(-len(vertices) // TILE), self.rows + 1, TILE, dtype=torch.float64)
        given = (
            vertices.detach().contiguous(),
            rest.contiguous(),
            rest.numel(),
            None if motion is None else motion.contiguous(),
        )
        layout = (self.members, self.groups, self.starts, self.row, self.values, self.rows)
        compiled = kernels()
        assert compiled is not None
        compiled.call("encode", torch.float32, *given, *layout, tiles, len(vertices))
        return tiles.transpose(1, 2).flatten(0, 1)[: len(vertices), :-1]


def _blocks(basis: Tensor, rows: Tensor, members: Tensor) -> Tensor:
    """The numbers of a group's vertices `(16,)` in some rows, eight rows after eight; 0 where there is no vertex or row."""
    chosen = basis[rows.clamp_max(len(basis) - 1)[:, None], members.clamp_min(0)]
    chosen = chosen * (rows < len(basis))[:, None, None] * (members >= 0)[:, None]
    return chosen.flatten(1).unflatten(0, (-1, BLOCK)).transpose(1, 2).flatten()


def _alike(moved_by: Tensor, vertices: Tensor) -> list[Tensor]:
    """Vertices `(vertex,)` in groups by what moves them `(vertex, number)`: halved where they differ most, again and again."""
    if len(vertices) <= GROUP:
        return [vertices]
    here = moved_by[vertices]
    here = here - here.mean(dim=0)
    direction = torch.ones(here.shape[1])
    for _ in range(PASSES):
        direction = here.T @ (here @ direction) + 1e-6 * direction
        direction /= direction.abs().max().clamp_min(1e-30)
    order = vertices[(here @ direction).argsort(stable=True)]
    half = -(-len(order) // (2 * GROUP)) * GROUP
    return [*_alike(moved_by, order[:half]), *_alike(moved_by, order[half:])]
