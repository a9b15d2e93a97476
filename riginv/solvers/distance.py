"""What a residual in mesh coordinates costs: half its square, or the mean distance of the vertices."""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.rig.batches import generator_at

CORNER_MM = 0.1
VERTICES = 2048


class Distance(NamedTuple):
    """What residuals `(mesh, coordinate)` cost.

    Attributes:
        cost: `(mesh,)`.
        pull: its gradient by the residual, `(mesh, coordinate)`.
        share: its curvature, about, as a share of that of half the square, `(mesh,)`; None: 1.
    """

    cost: Tensor
    pull: Tensor
    share: Tensor | None = None


def squared_distance(residual: Tensor) -> Distance:
    """Half the square of residuals `(mesh, coordinate)`, which is that of all vertices."""
    return Distance(0.5 * residual.square().sum(dim=1), residual)


class MeanDistance:
    """The distance of each vertex and not the square of it: what is reported in the end (pseudo-Huber).

    Squares let the worst places of a mesh decide for all others: what the rig cannot make, or a capture got wrong. A distance
    d costs c (sqrt(d^2 + c^2) - c), with the corner c: half of d^2 far below it, c d far above it, and nowhere more than
    either. Its curvature is taken for that of half the square, times the vertices' mean weight c / sqrt(d^2 + c^2).

    Args:
        frame: of the mesh space, `(coordinate, vertex, 3)`.
        corner_mm: c.
        vertices: so many, picked at random, stand in for all.
    """

    def __init__(self, frame: Tensor, corner_mm: float = CORNER_MM, vertices: int = VERTICES) -> None:
        picked = torch.randperm(frame.shape[1], generator=generator_at(0, "mean distance"))[:vertices]
        self.frame, self.corner_mm = frame[:, picked.to(frame.device)].flatten(1), corner_mm
        self.each = frame.shape[1] / len(picked)  # how many vertices one stands for

    def __call__(self, residual: Tensor) -> Distance:
        """Of residuals `(mesh, coordinate)`."""
        apart = (residual @ self.frame).unflatten(1, (-1, 3))
        rounded = (apart.square().sum(dim=2) + self.corner_mm**2).sqrt()
        weight = self.corner_mm / rounded
        pull = self.each * (weight[..., None] * apart).flatten(1) @ self.frame.T
        cost = self.each * self.corner_mm * (rounded - self.corner_mm).sum(dim=1)
        return Distance(cost, pull, weight.mean(dim=1))
