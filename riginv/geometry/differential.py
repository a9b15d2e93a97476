"""Differential coordinates: where each vertex stands among its neighbours."""

import torch
from torch import Tensor


def differential_coordinates(meshes: Tensor, faces: Tensor) -> Tensor:
    """Each vertex less the mean of its neighbours (the graph Laplacian); 0 for vertices without any.

    Args:
        meshes: vertices or displacements, `(mesh, vertex, 3)`.
        faces: `(face, 3)`.

    Returns:
        `(mesh, vertex, 3)`.
    """
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = torch.unique(torch.cat([edges, edges.flip(1)]), dim=0)
    degree = torch.bincount(edges[:, 0], minlength=meshes.shape[1]).to(meshes)
    total = torch.zeros_like(meshes).index_add_(1, edges[:, 0], meshes[:, edges[:, 1]])
    apart = meshes - total / degree.clamp_min(1)[:, None]
    return torch.where(degree[:, None] > 0, apart, 0.0)
