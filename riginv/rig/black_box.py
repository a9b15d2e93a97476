"""A rig that gives meshes and nothing else, seen as one that ends in a linear map: its basis is fitted to sampled poses."""

import logging

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.interpolation import coefficients_from, telling_vertices
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.jacobian import Jacobian, forward_jacobian
from riginv.rig.mesh_space import MeshSpace
from riginv.rig.random_controls import sparse_controls

LOG = logging.getLogger(__name__)
SEED = 20221206
CHECKED = 50  # poses that a basis is tried on after it has been fitted
WORTH_IT = 3  # times as many vertices as tell the coefficients must a mesh have
BATCH_SIZE = 50  # poses between two looks at the progress bar


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


class BlackBoxRig(LinearRig):
    """Any rig in the span of its own sampled poses: its coefficients are those of the mesh that it makes.

    Where the rig makes some of its vertices for less than all, they come of those that tell most.

    Args:
        rig: what is posed.
        basis: `(coefficient, vertex, 3)`, mm; its rows are orthogonal.

    Attributes:
        posed: the rig itself.
    """

    is_fitted = True

    def __init__(self, rig: RigBackend, basis: Tensor) -> None:
        super().__init__(rig.name, rig.controls, rig.rest_vertices, rig.faces, basis)
        self.posed, self.differentiable = rig, rig.differentiable
        squares = basis.flatten(1).square().sum(dim=1)
        self.register_buffer("projection", (basis.flatten(1) / squares[:, None]).T.contiguous(), persistent=False)
        self.some: nn.Module | None = None
        if rig.poses_some:
            lengths = squares.sqrt()
            frame = basis / lengths[:, None, None]
            rows = telling_vertices(frame)
            if WORTH_IT * len(rows) <= len(rig.rest_vertices):
                self.some = rig.some_vertices(rows)
                self.register_buffer("some_rest", rig.rest_vertices[rows], persistent=False)
                self.register_buffer("some_projection", coefficients_from(frame, rows) / lengths, persistent=False)

    @classmethod
    def sampled(cls, rig: RigBackend, samples: int, residual_mm: float) -> "BlackBoxRig":
        """Pose a rig at random, and keep as many principal components as it takes.

        Args:
            samples: how many poses.
            residual_mm: the mean vertex distance between the poses and the span of the basis that may remain.

        Raises:
            InputError: the rig gives NaN or infinite vertices.
        """
        limits = rig.lower, rig.upper, rig.neutral_controls
        controls = sparse_controls(*limits, len(rig.controls), samples, generator_at(SEED, "mesh space"))
        pieces = track(controls.split(BATCH_SIZE), f"sampling {rig.name}", console=Console(stderr=True), transient=True)
        with torch.no_grad():
            meshes = torch.cat([rig(piece) for piece in pieces])
        if not torch.isfinite(meshes).all():
            raise InputError(
                f"rig '{rig.name}' gives NaN or infinite vertices in random poses: run python -m riginv.check on it"
            )
        basis, residual = fitted_basis(rig.rest_vertices, meshes, residual_mm)
        fitted = cls(rig, basis)
        fitted._tell(residual)
        return fitted

    @torch.no_grad()
    def _tell(self, residual_mm: float) -> None:
        """Say how near the fitted basis comes, on poses that it was not fitted to."""
        limits = self.lower, self.upper, self.neutral_controls
        controls = sparse_controls(*limits, len(self.controls), CHECKED, generator_at(SEED, "mesh space, checked"))
        away = torch.cat([(self(piece) - self.posed(piece)).norm(dim=2) for piece in controls.split(BATCH_SIZE)])
        LOG.info(
            f"{self.name}: a basis of {len(self.basis)} coefficients, fitted to poses to {residual_mm:.2g} mm on average; "
            f"on {CHECKED} others {float(away.mean()):.2g} mm, at most {float(away.max()):.2g} mm (mesh_space in the config)"
        )

    def posing_rig(self) -> RigBackend:
        return self.posed

    def true_rig(self) -> RigBackend:
        return self.posed.true_rig()

    def coefficients(self, controls: Tensor) -> Tensor:
        if self.some is None:
            return self.coefficients_of(self.posed(controls))
        return (self.some(controls) - self.some_rest.to(controls)).flatten(1) @ self.some_projection.to(controls)

    @torch.no_grad()
    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        if self.some is None:
            return super().coefficient_jacobian(controls)
        return forward_jacobian(self.coefficients, controls)

    def coefficients_of(self, vertices: Tensor) -> Tensor:
        """The coefficients `(batch, coefficient)` of meshes `(batch, vertex, 3)`, mm, of the rig."""
        return (vertices - self.rest_vertices.to(vertices)).flatten(1) @ self.projection.to(vertices)

    def neutral_coefficients(self) -> Tensor:
        return self.basis.new_zeros(1, len(self.basis))
