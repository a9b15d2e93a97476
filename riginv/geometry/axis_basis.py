"""A basis of displacements whose rows each move vertices along one axis, as in skinning: products of a third of the cost."""

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.kernels.library import is_transformed

MIN_NUMBERS = 1_000_000  # of a basis: below it there is nothing to gain


def axis_by_axis(basis: Float[Tensor, "row vertex 3"]) -> Tensor | None:
    """The axis `(row,)` along which each row moves vertices, as in skinning; None where one has several."""
    if int(basis[:1].ne(0).any(dim=1).sum()) > 1:
        return None  # the first row tells of most rigs
    moved = torch.stack([basis[:, :, axis].ne(0).any(dim=1) for axis in range(3)], dim=1)
    return moved.int().argmax(dim=1) if bool((moved.sum(dim=1) <= 1).all()) else None


class AxisBasis:
    """Products with such a basis, as one matrix `(row, vertex)` for each axis.

    Args:
        basis: `(row, vertex, 3)`.
        axes: of its rows, `(row,)`.
    """

    def __init__(self, basis: Float[Tensor, "row vertex 3"], axes: Tensor) -> None:
        self.rows = [(axes == axis).nonzero()[:, 0] for axis in range(3)]
        self.matrices = [basis[rows, :, axis] for axis, rows in enumerate(self.rows)]

    def products(self, displacements: Float[Tensor, "batch vertex 3"]) -> Float[Tensor, "batch row"]:
        """The products of displacements with the rows, `(batch, row)`."""
        found = [displacements[:, :, axis] @ matrix.T for axis, matrix in enumerate(self.matrices)]
        return torch.cat(found, dim=1)[:, torch.cat(self.rows).argsort()]

    def displacements(self, coefficients: Float[Tensor, "batch row"]) -> Float[Tensor, "batch vertex 3"]:
        """The rows times coefficients, `(batch, vertex, 3)`."""
        return torch.stack([coefficients[:, rows] @ matrix for rows, matrix in zip(self.rows, self.matrices)], dim=2)


class AxisBasisCache:
    """The `AxisBasis` of the last basis that was asked for."""

    def __init__(self) -> None:
        self.last: tuple[Tensor, AxisBasis | None] | None = None

    def get(self, basis: Float[Tensor, "row vertex 3"], values: Tensor) -> AxisBasis | None:
        """That of a large basis, on a CPU; None for others, for values of another type, and where a program is traced."""
        is_other = basis.device.type != "cpu" or basis.dtype != values.dtype or is_transformed((basis, values))
        if basis.numel() < MIN_NUMBERS or is_other:
            return None
        found = self.last  # read once: other threads may replace it
        if found is None or found[0] is not basis:
            axes = axis_by_axis(basis)
            found = self.last = basis, None if axes is None else AxisBasis(basis, axes)
        return found[1]
