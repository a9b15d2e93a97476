"""Mesh coordinates by way of the products of a mesh with the rig's basis, most of which is 0, on a CPU.

With the basis B = M Q, Q the orthonormal directions of the mesh space, the coordinates Q d of a displacement d are M^+ (B d).
"""

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.distances import FrameDistances
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.sparse_basis import MIN_NUMBERS, SparseBasis
from riginv.runs.huge_pages import in_huge_pages

PROBES, TOLERANCE = 8, 2e-5  # random meshes, and how far their coordinates may be from the dense ones, of their size


class SparseEncoder:
    """As `MeshSpace.encode`, several times as fast, on a CPU in float32.

    Args:
        rig: in mesh space.
        basis: its basis.
    """

    def __init__(self, rig: RigInMeshSpace, basis: SparseBasis) -> None:
        self.basis, directions = basis, rig.space.directions  # which the basis spans: the products are of full column rank
        left, upper = torch.linalg.qr(basis.products(torch.zeros_like(directions[0]), directions).T)
        self.matrix = in_huge_pages([torch.linalg.solve_triangular(upper, left.T, upper=True).T])[0]

    @classmethod
    def for_rig(cls, rig: RigInMeshSpace) -> "SparseEncoder | None":
        """None where a rig's basis is small or not sparse, does not span the space, or there are no kernels for it.

        Nor for rigs without blendshapes, which may move by metres: the tolerance is relative to that.
        """
        directions, basis = rig.space.directions, rig.source.basis
        if not rig.source.has_blendshapes or directions.numel() < MIN_NUMBERS or len(basis) < len(directions):
            return None
        sparse = SparseBasis.of(basis)
        if sparse is None:
            return None
        found = cls(rig, sparse)
        generator = torch.Generator().manual_seed(0)
        meshes = rig.space.rest_vertices + torch.randn(PROBES, *basis.shape[1:], generator=generator)
        apart = (found(rig.space.rest_vertices, meshes) - rig.space.encode(meshes)).norm(dim=1)
        size = (meshes - rig.space.rest_vertices).flatten(1).norm(dim=1)
        return found if bool((apart <= TOLERANCE * size).all()) else None

    def __call__(
        self, rest: Float[Tensor, "vertex 3"], vertices: Float[Tensor, "batch vertex 3"], motion: Tensor | None = None
    ) -> Float[Tensor, "batch coordinate"]:
        """Meshes `(batch, vertex, 3)`, mm, to mesh coordinates; arguments as for `SparseBasis.products`."""
        return (self.basis.products(rest, vertices, motion) @ self.matrix).float()

    def compare(
        self,
        rest: Float[Tensor, "vertex 3"],
        vertices: Float[Tensor, "batch vertex 3"],
        motion: Tensor | None,
        coefficients: Float[Tensor, "batch coefficient"],
    ) -> tuple[Tensor, FrameDistances, FrameDistances]:
        """The coordinates of meshes, and their distances, as from `SparseBasis.compare`."""
        products, distances, neutral = self.basis.compare(rest, vertices, motion, coefficients)
        return (products @ self.matrix).float(), distances, neutral
