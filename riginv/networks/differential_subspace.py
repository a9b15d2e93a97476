"""Song et al. 2020: a surrogate that learns differential coordinates and, separately, the positions of a few anchors.

Source: Song, Shi, Reed: Accurate face rig approximation with deep differential subspace reconstruction (SIGGRAPH 2020, arXiv
2006.01746). One MLP gives the differential coordinates, as principal components; a smaller one the positions of
anchors, which hold the low frequencies that differential coordinates hardly see; least squares combine both to a mesh.

Changed: the least squares are solved within the rig's mesh space, where they are one fixed linear map; both MLPs are
trained together on the loss of the resulting mesh, as our other surrogates are, where theirs have separate losses; the
components are those of the rig's deltas, not of posed examples; the graph Laplacian, anchors spread by distance,
their number and their weight are our choices.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from riginv.config.values import PositiveInt, Widths
from riginv.errors import InputError
from riginv.geometry.neighbours import differential_coordinates, spread_points
from riginv.networks.mlp import mlp
from riginv.networks.surrogate import SurrogateNetwork
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace


class Reconstruction(NamedTuple):
    """The fixed linear maps of the method.

    Attributes:
        differential: principal components of differential coordinates, `(component, vertex, 3)`.
        anchors: principal components of the anchors' displacements, `(component, anchor, 3)`.
        from_differential, from_anchors: components to the coefficients of the least-squares mesh, `(component, coefficient)`.
    """

    differential: Tensor
    anchors: Tensor
    from_differential: Tensor
    from_anchors: Tensor


def reconstruction(
    rig: LinearRig, anchors: Int[Tensor, " anchor"], weight: float, components: int | None = None
) -> Reconstruction:
    """The least-squares maps from differential coordinates and anchors to meshes in the span of a rig's basis.

    Args:
        anchors: indices of vertices.
        weight: of the anchors' squared errors against those of the differential coordinates.
        components: of the differential coordinates, at most; None: all.
    """
    space = MeshSpace.from_rig(rig)
    frame = space.directions.double()
    local, positions = differential_coordinates(frame, rig.faces).flatten(1), frame[:, anchors].flatten(1)
    deltas = rig.basis.double().flatten(1) @ frame.flatten(1).T
    local_parts = _principal(deltas @ local)[:components]
    anchor_parts = _principal(deltas @ positions)
    normal = local @ local.T + weight * positions @ positions.T
    normal.diagonal().add_(1e-9 * normal.diagonal().mean())
    to_coefficients = torch.linalg.solve(normal, torch.linalg.pinv(deltas))
    maps = Reconstruction(
        local_parts.unflatten(1, (-1, 3)),
        anchor_parts.unflatten(1, (-1, 3)),
        local_parts @ local.T @ to_coefficients,
        weight * anchor_parts @ positions.T @ to_coefficients,
    )
    return Reconstruction(*(values.to(rig.dtype) for values in maps))


def _principal(seen: Tensor) -> Tensor:
    """Principal components `(component, value)` of `(sample, value)`, scaled by the samples' spread, largest first.

    Zero components are kept, so that a loaded network has the same number.
    """
    _, left = torch.linalg.eigh(seen @ seen.T)
    return (left.flip(1).T @ seen)[: seen.shape[1]] / len(seen) ** 0.5


class DifferentialSubspace(SurrogateNetwork):
    """Two MLPs on the controls, as fractions of their ranges, and a fixed reconstruction.

    Args:
        hidden: widths for the differential coordinates.
        subspace_hidden: widths for the anchors.
        anchors: the number of anchor vertices.
        anchor_weight: of the anchors in the least squares.
        components: principal components of the differential coordinates, at most; None: all.

    Raises:
        InputError: a number is out of range.
    """

    from_differential: Tensor
    from_anchors: Tensor
    neutral: Tensor
    span: Tensor

    def __init__(
        self,
        rig: LinearRig,
        hidden: Widths = (1024, 1024),
        subspace_hidden: Widths = (256, 256),
        anchors: PositiveInt = 64,
        anchor_weight: float = 1.0,
        components: int | None = None,
        activation: str = "leaky_relu",
    ) -> None:
        super().__init__(rig)
        for name, value in (("anchors", anchors), ("components", components)):
            if value is not None and value < 1:
                raise InputError(f"network: {name} is {value}, expected at least 1")
        if not anchor_weight > 0:
            raise InputError(f"network: anchor_weight is {anchor_weight}, expected above 0")
        maps = reconstruction(rig, spread_points(rig.rest_vertices, anchors), anchor_weight, components)
        # Kept with the weights: another machine may find the same components with other signs.
        self.register_buffer("from_differential", maps.from_differential)
        self.register_buffer("from_anchors", maps.from_anchors)
        self.register_buffer("neutral", rig.neutral_controls, persistent=False)
        self.register_buffer("span", rig.upper - rig.lower, persistent=False)
        self.differential = mlp(len(rig.controls), hidden, len(self.from_differential), activation)
        self.subspace = mlp(len(rig.controls), subspace_hidden, len(self.from_anchors), activation)

    def set_scales(self, rig: LinearRig, controls: Tensor) -> None:
        """Does nothing: components are scaled by their spread already."""

    def forward(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        """As `raw`: coefficients of a reconstructed mesh need no sigmoid."""
        return self.raw(controls)

    def raw(self, controls: Float[Tensor, "batch control"]) -> Float[Tensor, "batch coefficient"]:
        away = (controls - self.neutral) / self.span
        return self.differential(away) @ self.from_differential + self.subspace(away) @ self.from_anchors
