"""A rig that gives meshes and nothing else, seen as one that ends in a linear map: its basis is fitted to sampled poses."""

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor

from riginv.errors import InputError
from riginv.mesh_space import MeshSpace
from riginv.rig import LinearRig, RigBackend
from riginv.sampling.controls import sparse_controls
from riginv.sampling.seeds import generator_at

SEED = 20221206
PIECE = 50  # poses between two looks at the progress bar


def fitted_basis(rest_vertices: Tensor, samples: Tensor, residual_mm: float) -> tuple[Tensor, float]:
    """The principal components `(coefficient, vertex, 3)` of sampled meshes, each as long as the samples are spread along it.

    Args:
        rest_vertices: `(vertex, 3)`, mm.
        samples: `(sample, vertex, 3)`, mm.
        residual_mm: the mean vertex distance that may remain.

    Returns:
        The basis, and the residual that did remain, mm.

    Raises:
        InputError: as `MeshSpace.from_samples`.
    """
    space = MeshSpace.from_samples(rest_vertices, samples, residual_mm)
    spread = space.encode(samples).square().mean(dim=0).sqrt()
    return space.frame * spread.clamp_min(1e-6)[:, None, None], space.residual_mm


class FittedRig(LinearRig):
    """Any rig in the span of its own sampled poses: its coefficients are those of the mesh that it makes.

    Args:
        rig: what is posed.
        basis: `(coefficient, vertex, 3)`, mm; its rows are orthogonal.

    Attributes:
        posed: the rig itself.
    """

    def __init__(self, rig: RigBackend, basis: Tensor) -> None:
        super().__init__(rig.name, rig.controls, rig.rest_vertices, rig.faces, basis)
        self.posed, self.differentiable = rig, rig.differentiable
        squares = basis.flatten(1).square().sum(dim=1)
        self.register_buffer("projection", (basis.flatten(1) / squares[:, None]).T.contiguous(), persistent=False)

    @classmethod
    def sampled(cls, rig: RigBackend, samples: int, residual_mm: float) -> "FittedRig":
        """Pose a rig at random, and keep as many principal components as it takes.

        Args:
            samples: how many poses.
            residual_mm: the mean vertex distance between the poses and the span of the basis that may remain.

        Raises:
            InputError: the rig gives NaN or infinite vertices.
        """
        limits = rig.lower, rig.upper, rig.neutral_controls
        controls = sparse_controls(*limits, len(rig.controls), samples, generator_at(SEED, "mesh space"))
        pieces = track(controls.split(PIECE), f"sampling {rig.name}", console=Console(stderr=True), transient=True)
        with torch.no_grad():
            meshes = torch.cat([rig(piece) for piece in pieces])
        if not torch.isfinite(meshes).all():
            raise InputError(
                f"rig '{rig.name}' gives NaN or infinite vertices in random poses: run python -m riginv.check on it"
            )
        basis, _ = fitted_basis(rig.rest_vertices, meshes, residual_mm)
        return cls(rig, basis)

    def coefficients(self, controls: Tensor) -> Tensor:
        return self.coefficients_of(self.posed(controls))

    def coefficients_of(self, vertices: Tensor) -> Tensor:
        """The coefficients `(batch, coefficient)` of meshes `(batch, vertex, 3)`, mm, of the rig."""
        return (vertices - self.rest_vertices.to(vertices)).flatten(1) @ self.projection.to(vertices)

    def neutral_coefficients(self) -> Tensor:
        return self.basis.new_zeros(1, len(self.basis))
