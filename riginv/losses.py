"""Losses in mesh coordinates: each equals, constant aside, a loss on all vertices (`riginv.mesh_space`)."""

import torch
from torch import Tensor, nn

EPSILON_MM = 0.01  # keeps the root's gradient finite where the error vanishes


class SquaredVertexLoss(nn.Module):
    """The paper's: the mean squared error of the vertices' coordinates, mm^2.

    Args:
        vertex_count: of the full mesh, so that the value is that of the full mesh.
    """

    def __init__(self, vertex_count: int) -> None:
        super().__init__()
        self.vertex_count = vertex_count

    def forward(self, coordinates: Tensor, target: Tensor) -> Tensor:
        """Both `(batch, coordinate)`; a scalar."""
        return (coordinates - target).square().sum(dim=1).mean() / (3 * self.vertex_count)


class VertexDistanceLoss(nn.Module):
    """The root mean square distance of the vertices, mm, averaged over the meshes.

    Unlike the squared error it asks as much of a nearly neutral mesh as of a wild one.
    """

    def __init__(self, vertex_count: int) -> None:
        super().__init__()
        self.vertex_count = vertex_count

    def forward(self, coordinates: Tensor, target: Tensor) -> Tensor:
        """Both `(batch, coordinate)`; a scalar."""
        squared = (coordinates - target).square().sum(dim=1) / self.vertex_count
        return (squared + EPSILON_MM**2).sqrt().mean()


class CoefficientLoss(nn.Module):
    """How far coefficients are from those that are wanted, each in the mm that it moves the mesh by, mm.

    Where a rig has names for what it does, this teaches each of them apart; on the mesh alone they hide behind each other.

    Args:
        linear_map: `(coefficient, coordinate)`, as of `riginv.mesh_space.RigInMeshSpace`.
        vertex_count: of the full mesh.
    """

    sizes: Tensor

    def __init__(self, linear_map: Tensor, vertex_count: int) -> None:
        super().__init__()
        self.register_buffer("sizes", linear_map.square().sum(dim=1) / vertex_count, persistent=False)

    def forward(self, coefficients: Tensor, wanted: Tensor) -> Tensor:
        """Both `(batch, coefficient)`; a scalar."""
        return (((coefficients - wanted).square() @ self.sizes) + EPSILON_MM**2).sqrt().mean()


def root_mean_square_mm(coordinates: Tensor, target: Tensor, vertex_count: int) -> Tensor:
    """The root mean square distance of the vertices over a batch, mm, from mesh coordinates `(batch, coordinate)`."""
    with torch.no_grad():
        return ((coordinates - target).square().sum(dim=1).mean() / vertex_count).sqrt()
