"""Distances between the vertices of meshes, frame by frame."""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.geometry.kernels.library import kernels_for


class FrameDistances(NamedTuple):
    """Distances between vertices of meshes, summed up for each frame; 0 where none is known.

    Attributes:
        known: the number of vertices whose distance is known, `(frame,)`.
        mean, worst: mean and largest distance, `(frame,)`, mm.
        vertex: the vertex of the largest one, `(frame,)`.
        squares: the sum of the squared distances, `(frame,)`, mm^2.
    """

    known: Tensor
    mean: Tensor
    worst: Tensor
    vertex: Tensor
    squares: Tensor


def frame_distances(meshes: Tensor, others: Tensor, counted: Tensor | None = None) -> FrameDistances:
    """Distances of meshes `(frame, vertex, 3)`, mm, from as many others, or from one `(1, vertex, 3)`; NaN is not known.

    Args:
        counted: whether each vertex counts, `(vertex,)`; None: all do.
    """
    compiled = kernels_for(meshes, others)
    if compiled is not None:
        rows = torch.empty(len(meshes), 5, dtype=torch.float64)
        flags = None if counted is None else counted.to(torch.int8)
        given = (meshes.contiguous(), others.contiguous(), int(len(others) == 1), flags, meshes.shape[1], rows, len(meshes))
        compiled.call("distances", meshes.dtype, *given)
        known, total, worst, vertex, squares = rows.unbind(dim=1)
    else:
        square = (meshes - others).square().sum(dim=2)
        is_known = torch.isfinite(square) if counted is None else torch.isfinite(square) & counted
        square = torch.where(is_known, square, 0.0)
        known, total, squares = is_known.sum(dim=1), square.sqrt().sum(dim=1), square.sum(dim=1)
        largest, vertex = square.max(dim=1)
        worst = largest.sqrt()
    mean = total / known.clamp_min(1)
    return FrameDistances(known.long(), mean.to(meshes), worst.to(meshes), vertex.long(), squares)
