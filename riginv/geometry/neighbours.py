"""Differential coordinates, and evenly spread subsets of points."""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def differential_coordinates(
    meshes: Float[Tensor, "mesh vertex 3"], faces: Int[Tensor, "face 3"]
) -> Float[Tensor, "mesh vertex 3"]:
    """Each vertex minus the mean of its neighbours (the graph Laplacian); 0 for vertices without neighbours.

    Args:
        meshes: vertices or displacements.
    """
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = torch.unique(torch.cat([edges, edges.flip(1)]), dim=0)
    degree = torch.bincount(edges[:, 0], minlength=meshes.shape[1]).to(meshes)
    total = torch.zeros_like(meshes).index_add_(1, edges[:, 0], meshes[:, edges[:, 1]])
    difference = meshes - total / degree.clamp_min(1)[:, None]
    return torch.where(degree[:, None] > 0, difference, 0.0)


def evenly(count: int, of: int) -> Int[Tensor, " row"]:
    """`count` evenly spread indices `(row,)` below `of`, with the first and the last; all of them where `of` is no larger."""
    return torch.linspace(0, of - 1, min(count, of), dtype=torch.float64).round().long()


def spread_points(points: Float[Tensor, "point dimension"], count: int) -> Int[Tensor, " chosen"]:
    """Farthest point sampling: indices `(count,)` of points `(point, dimension)`, the one nearest to their mean first.

    All of them where there are no more than `count`.
    """
    chosen = [int((points - points.mean(dim=0)).norm(dim=1).argmin())]
    distance = (points - points[chosen[0]]).norm(dim=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(distance.argmax()))
        distance = torch.minimum(distance, (points - points[chosen[-1]]).norm(dim=1))
    return torch.tensor(chosen, device=points.device)
