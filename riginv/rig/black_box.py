"""A black-box rig as one that ends in a linear map: its basis is fitted to sampled poses."""

import logging

import torch
from jaxtyping import Float
from rich.console import Console
from rich.progress import track
from torch import Tensor, nn

from riginv.errors import InputError
from riginv.geometry.interpolation import coefficients_from, informative_vertices
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.jacobian import Jacobian, forward_jacobian
from riginv.rig.mesh_space import MeshSpace
from riginv.rig.random_controls import sparse_controls

LOG = logging.getLogger(__name__)
SEED = 20221206
CHECKED = 50  # poses that a fitted basis is checked on
MIN_SUBSET_RATIO = 3  # a vertex subset is used if the mesh has at least this many times its vertices
BATCH_SIZE = 50
GRADIENT_STEPS = 6  # a gradient costs as much as one to two columns of the Jacobian


def fitted_basis(
    rest_vertices: Float[Tensor, "vertex 3"], samples: Float[Tensor, "sample vertex 3"], residual_mm: float
) -> tuple[Float[Tensor, "coefficient vertex 3"], float]:
    """The principal components `(coefficient, vertex, 3)` of sampled meshes, each scaled by the samples' spread along it.

    Args:
        rest_vertices: in mm.
        samples: in mm.
        residual_mm: the mean vertex distance that may remain.

    Returns:
        The basis, and the residual that remains, mm.

    Raises:
        InputError: as `MeshSpace.from_samples`.
    """
    space = MeshSpace.from_samples(rest_vertices, samples, residual_mm)
    spread = space.encode(samples).square().mean(dim=0).sqrt()
    return space.directions * spread.clamp_min(1e-6)[:, None, None], space.residual_mm


class BlackBoxRig(LinearRig):
    """Any rig, projected onto the span of its own sampled poses: its coefficients are those of its meshes in that basis.

    Where the rig can pose a subset of its vertices cheaply, the coefficients are computed from the most informative ones.

    Args:
        rig: the rig that is posed.
        basis: `(coefficient, vertex, 3)`, mm; its rows are orthogonal.

    Attributes:
        posed: the rig that is posed.
    """

    is_fitted = True
    projection: Tensor
    some_rest: Tensor
    some_projection: Tensor

    def __init__(self, rig: RigBackend, basis: Tensor) -> None:
        super().__init__(rig.name, rig.controls, rig.rest_vertices, rig.faces, basis)
        self.posed = rig
        self.differentiable = rig.differentiable
        self.gradient_steps = GRADIENT_STEPS if rig.differentiable else 0
        squares = basis.flatten(1).square().sum(dim=1)
        self.register_buffer("projection", (basis.flatten(1) / squares[:, None]).T.contiguous(), persistent=False)
        self.some: nn.Module | None = None
        if rig.poses_subsets:
            lengths = squares.sqrt()
            frame = basis / lengths[:, None, None]
            rows = informative_vertices(frame)
            if MIN_SUBSET_RATIO * len(rows) <= len(rig.rest_vertices):
                self.some = rig.vertex_subset(rows)
                self.register_buffer("some_rest", rig.rest_vertices[rows], persistent=False)
                self.register_buffer("some_projection", coefficients_from(frame, rows) / lengths, persistent=False)

    @classmethod
    def sampled(cls, rig: RigBackend, samples: int, residual_mm: float) -> "BlackBoxRig":
        """Fit the basis to random poses of a rig, with as many principal components as the residual needs.

        Args:
            samples: the number of poses.
            residual_mm: the mean vertex distance that may remain between the poses and the span of the basis.

        Raises:
            InputError: the rig gives NaN or infinite vertices.
        """
        limits = rig.lower, rig.upper, rig.neutral_controls
        controls = sparse_controls(*limits, len(rig.controls), samples, generator_at(SEED, "mesh space"))
        batches = track(controls.split(BATCH_SIZE), f"sampling {rig.name}", console=Console(stderr=True), transient=True)
        with torch.no_grad():
            meshes = torch.cat([rig(batch) for batch in batches])
        if not torch.isfinite(meshes).all():
            raise InputError(
                f"rig '{rig.name}' gives NaN or infinite vertices in random poses: run python -m riginv.check on it"
            )
        basis, residual = fitted_basis(rig.rest_vertices, meshes, residual_mm)
        result = cls(rig, basis)
        result._log_residual(residual)
        return result

    @torch.no_grad()
    def _log_residual(self, residual_mm: float) -> None:
        """Log the residual of the basis on poses that it was not fitted to."""
        limits = self.lower, self.upper, self.neutral_controls
        controls = sparse_controls(*limits, len(self.controls), CHECKED, generator_at(SEED, "mesh space, checked"))
        errors = torch.cat([(self(batch) - self.posed(batch)).norm(dim=2) for batch in controls.split(BATCH_SIZE)])
        LOG.info(
            f"{self.name}: a basis of {len(self.basis)} coefficients, fitted to poses to {residual_mm:.2g} mm on average; "
            f"on {CHECKED} others {float(errors.mean()):.2g} mm, at most {float(errors.max()):.2g} mm (config: mesh_space)"
        )

    def posing_rig(self) -> RigBackend:
        return self.posed

    def true_rig(self) -> RigBackend:
        return self.posed.true_rig()

    def coefficients(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        if self.some is None:
            return self.coefficients_of(self.posed(controls))
        return (self.some(controls) - self.some_rest.to(controls)).flatten(1) @ self.some_projection.to(controls)

    @torch.no_grad()
    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        if self.some is None:
            return super().coefficient_jacobian(controls)
        return forward_jacobian(self.coefficients, controls)

    def coefficients_of(self, vertices: Float[Tensor, "batch vertex 3"]) -> Float[Tensor, "batch coefficient"]:
        """The coefficients `(batch, coefficient)` of meshes `(batch, vertex, 3)`, mm, of the rig."""
        return (vertices - self.rest_vertices.to(vertices)).flatten(1) @ self.projection.to(vertices)

    def neutral_coefficients(self) -> Tensor:
        return self.basis.new_zeros(1, len(self.basis))
