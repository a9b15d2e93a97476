"""Losses in mesh coordinates: each equals, constant aside, a loss on all vertices (`riginv.rig.mesh_space`)."""

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from riginv.rig.batches import generator_at

EPSILON_MM = 0.01  # keeps the root's gradient finite where the error vanishes


class LengthLoss(nn.Module, ABC):
    """A loss that looks at nothing but the length of each mesh's error: its gradient is the error itself, times a number.

    Args:
        vertex_count: of the full mesh, so that the value is that of the full mesh.

    Attributes:
        mean_of_meshes: the loss of a batch is the mean over its meshes, so that its parts can be computed apart.
    """

    mean_of_meshes = True

    def __init__(self, vertex_count: int) -> None:
        super().__init__()
        self.vertex_count = vertex_count

    def forward(self, coordinates: Tensor, target: Tensor) -> Tensor:
        """Both `(batch, coordinate)`; a scalar."""
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


class VertexDistanceLoss(LengthLoss):
    """The root mean square distance of the vertices, mm, averaged over the meshes.

    Unlike the squared error it asks as much of a nearly neutral mesh as of a wild one.
    """

    def of_squares(self, squares: Tensor) -> Tensor:
        return (squares / self.vertex_count + EPSILON_MM**2).sqrt()

    def derivatives(self, squares: Tensor) -> Tensor:
        return 0.5 / (self.vertex_count * self.of_squares(squares))


class MeanDistanceLoss(nn.Module):
    """The mean distance of some vertices, mm: what is reported in the end, where the others stand in for it.

    Squares let the worst places of a mesh decide for all others. Of vertices picked at random the mean is nearly that of all.

    Args:
        frame: of the mesh space, `(coordinate, vertex, 3)`.
        vertices: how many are picked, once for all.
    """

    mean_of_meshes = True
    frame: Tensor

    def __init__(self, frame: Tensor, vertices: int) -> None:
        super().__init__()
        picked = torch.randperm(frame.shape[1], generator=generator_at(0, "loss vertices"))[:vertices]
        self.register_buffer("frame", frame[:, picked.to(frame.device)].flatten(1), persistent=False)

    def forward(self, coordinates: Tensor, target: Tensor) -> Tensor:
        """Both `(batch, coordinate)`; a scalar."""
        apart = ((coordinates - target) @ self.frame).unflatten(1, (-1, 3))
        return (apart.square().sum(dim=2) + EPSILON_MM**2).sqrt().mean()


class CoefficientLoss(nn.Module):
    """How far coefficients are from those that are wanted, each in the mm that it moves the mesh by, mm.

    Where a rig has names for what it does, this teaches each of them apart; on the mesh alone they hide behind each other.

    Args:
        linear_map: `(coefficient, coordinate)`, as of `riginv.rig.mesh_space.RigInMeshSpace`.
        vertex_count: of the full mesh.
    """

    mean_of_meshes = True
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
