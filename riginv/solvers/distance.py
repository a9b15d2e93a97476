"""Costs of a residual in mesh coordinates: half its square, or the sum of the vertices' distances."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.rig.batches import generator_at

CORNER_MM = 0.03
VERTICES = 2048


class Distance(NamedTuple):
    """The cost of residuals `(mesh, coordinate)`.

    Attributes:
        cost: `(mesh,)`.
        gradient: by the residual, `(mesh, coordinate)`.
        curvature: approximately, relative to half the square, `(mesh,)`; None: 1.
    """

    cost: Tensor
    gradient: Tensor
    curvature: Tensor | None = None


def squared_distance(residual: Float[Tensor, "mesh coordinate"]) -> Distance:
    """Half the square of residuals `(mesh, coordinate)`: half the sum of the vertices' squared distances."""
    return Distance(0.5 * residual.square().sum(dim=1), residual)


class MeanDistance:
    """The sum of the vertices' distances, rounded near 0 (pseudo-Huber): robust to places that the rig cannot reach.

    A distance d costs c (sqrt(d^2 + c^2) - c), with the corner c: d^2 / 2 far below it, c d far above it, and nowhere more than
    either. Its curvature is approximated by that of half the square times the vertices' mean weight c / sqrt(d^2 + c^2).

    Args:
        frame: of the mesh space, `(coordinate, vertex, 3)`.
        corner_mm: c.
        vertices: the number of random vertices that represent all.
    """

    def __init__(
        self, frame: Float[Tensor, "coordinate vertex 3"], corner_mm: float = CORNER_MM, vertices: int = VERTICES
    ) -> None:
        picked = torch.randperm(frame.shape[1], generator=generator_at(0, "mean distance"))[:vertices]
        self.frame, self.corner_mm = frame[:, picked.to(frame.device)].flatten(1), corner_mm
        self.each = frame.shape[1] / len(picked)  # the number of vertices that one represents

    def __call__(self, residual: Float[Tensor, "mesh coordinate"]) -> Distance:
        """The cost of residuals `(mesh, coordinate)`."""
        displacement = (residual @ self.frame).unflatten(1, (-1, 3))
        rounded = (displacement.square().sum(dim=2) + self.corner_mm**2).sqrt()
        weight = self.corner_mm / rounded
        gradient = self.each * (weight[..., None] * displacement).flatten(1) @ self.frame.T
        cost = self.each * self.corner_mm * (rounded - self.corner_mm).sum(dim=1)
        return Distance(cost, gradient, weight.mean(dim=1))
