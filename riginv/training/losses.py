"""Losses in mesh coordinates: each equals, constant aside, a loss on all vertices (`riginv.rig.mesh_space`)."""

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from riginv.networks.distance_weights import DistanceWeights
from riginv.rig.mesh_space import MeshSpace

EPSILON_MM = 0.01  # keeps the root's gradient finite where the error vanishes


class LengthLoss(nn.Module, ABC):
    """A loss that depends only on the norm of each mesh's error, so that its gradient is the error times a scalar.

    Args:
        vertex_count: number of vertices of the mesh; scales the value to the full mesh.

    Attributes:
        mean_of_meshes: whether a batch's loss is the mean over its meshes, so that parts can be computed separately.
    """

    mean_of_meshes = True

    def __init__(self, vertex_count: int) -> None:
        super().__init__()
        self.vertex_count = vertex_count

    def forward(self, coordinates: Tensor, target: Tensor) -> Tensor:
        """The loss, a scalar, of mesh coordinates against their target, both `(batch, coordinate)`."""
        return self.of_squares((coordinates - target).square().sum(dim=1)).mean()

    @abstractmethod
    def of_squares(self, squares: Tensor) -> Tensor:
        """The loss of each mesh `(batch,)`, of which `forward` is the mean, from the squared length of its error `(batch,)`."""

    @abstractmethod
    def derivatives(self, squares: Tensor) -> Tensor:
        """The derivative `(batch,)` of `of_squares`."""


class SquaredVertexLoss(LengthLoss):
    """The paper's: the mean squared error of the vertices' coordinates, mm^2."""

    def of_squares(self, squares: Tensor) -> Tensor:
        return squares / (3 * self.vertex_count)

    def derivatives(self, squares: Tensor) -> Tensor:
        return torch.full_like(squares, 1 / (3 * self.vertex_count))


class RmsVertexDistanceLoss(LengthLoss):
    """The root mean square distance of the vertices, mm, averaged over the meshes.

    Unlike the squared error it weights nearly neutral and extreme meshes about equally.
    """

    def of_squares(self, squares: Tensor) -> Tensor:
        return (squares / self.vertex_count + EPSILON_MM**2).sqrt()

    def derivatives(self, squares: Tensor) -> Tensor:
        return 0.5 / (self.vertex_count * self.of_squares(squares))


class MeanDistanceLoss(nn.Module):
    """The mean distance of the central vertices of clusters, weighted by the clusters' sizes, mm: about the reported error.

    Squared losses are dominated by the largest errors of a mesh.

    Args:
        space: the mesh space.
        vertices: the number of clusters.
    """

    mean_of_meshes = True

    def __init__(self, space: MeshSpace, vertices: int) -> None:
        super().__init__()
        self.distance = DistanceWeights(space, vertices)
        self.distance.calibrate(space)

    def forward(self, coordinates: Tensor, target: Tensor) -> Tensor:
        """The loss, a scalar, of mesh coordinates against their target, both `(batch, coordinate)`."""
        return self.distance(coordinates - target).distance.mean()

    def value_and_derivative(self, error: Tensor) -> tuple[Tensor, Tensor]:
        """The loss, a scalar, and its derivative by the errors of mesh coordinates `(batch, coordinate)`, without a graph."""
        with torch.no_grad():
            distance, scale, weighted = self.distance(error)
            scale = len(error) * self.distance.counts.sum() * scale.clamp_min(torch.finfo(scale.dtype).tiny)
            return distance.mean(), weighted / scale


class CoefficientLoss(nn.Module):
    """The root mean square error of coefficients, mm, each weighted by its effect on the mesh.

    For rigs with named blendshapes: a loss on the mesh alone lets errors of overlapping shapes compensate each other.

    Args:
        linear_map: `(coefficient, coordinate)`, as of `riginv.rig.mesh_space.RigInMeshSpace`.
        vertex_count: of the full mesh.
    """

    mean_of_meshes = True
    sizes: Tensor

    def __init__(self, linear_map: Tensor, vertex_count: int) -> None:
        super().__init__()
        self.register_buffer("sizes", linear_map.square().sum(dim=1) / vertex_count, persistent=False)

    def forward(self, coefficients: Tensor, target: Tensor) -> Tensor:
        """The loss, a scalar, of coefficients against their target, both `(batch, coefficient)`."""
        return (((coefficients - target).square() @ self.sizes) + EPSILON_MM**2).sqrt().mean()


def root_mean_square_mm(coordinates: Tensor, target: Tensor, vertex_count: int) -> Tensor:
    """The root mean square distance of the vertices over a batch, mm, from mesh coordinates `(batch, coordinate)`."""
    with torch.no_grad():
        return ((coordinates - target).square().sum(dim=1).mean() / vertex_count).sqrt()
