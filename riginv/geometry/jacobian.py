"""The Jacobian of a rig's nonlinear part, in a form that exploits how little of it is not zero.

Correctives follow the weights of a few shapes each. So d coefficients / d controls is a product of two: a sparse matrix, whose
pattern never changes, from the shapes that are driven directly to all coefficients, and a small dense one from the controls to
those shapes.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.autograd import forward_ad

FORWARD = 1024  # rows of a batch in forward mode, one for each control of each pose
PIECE = 16  # Jacobians at a time: what a processor's cache holds

# PyTorch says so of every sparse matrix, once; multiplying one with a dense matrix is all that is asked of them here.
warnings.filterwarnings("ignore", message=".*Sparse CSR tensor support is in beta state.*")


class Pattern:
    """Where a sparse matrix `(coefficient, shape)` has entries.

    Args:
        rows, columns: `(entry,)`, in any order, no place twice.
        shape: of the matrix.
    """

    def __init__(self, rows: Tensor, columns: Tensor, shape: tuple[int, int]) -> None:
        self.shape, self.rows, self.columns = shape, rows, columns
        self.order = torch.argsort(columns * shape[0] + rows)  # the transpose's, row by row
        counts = torch.bincount(columns, minlength=shape[1])
        self.starts = torch.cat([counts.new_zeros(1), counts.cumsum(0)])

    def transposed(self, values: Tensor, apart: bool) -> Tensor:
        """The transposes of matrices with entries `values` `(batch, entry)`, one below the other, as one sparse matrix.

        Args:
            apart: whether each has columns of its own, so that the matrix is block-diagonal, or all share them.
        """
        batch, (coefficients, shapes) = len(values), self.shape
        number = torch.arange(batch, device=values.device)[:, None]
        starts = torch.cat([self.starts[:1], (self.starts[1:] + number * len(self.rows)).flatten()])
        columns = (self.rows[self.order] + number * (coefficients if apart else 0)).flatten()
        size = (batch * shapes, coefficients * (batch if apart else 1))
        return torch.sparse_csr_tensor(starts, columns, values[:, self.order].flatten(), size=size, check_invariants=False)


@dataclass(frozen=True)
class Jacobian:
    """d coefficients / d controls of a batch, `(batch, coefficient, control)`: `outer` times `inner`.

    Attributes:
        inner: `(batch, shape, control)`, dense; or, where there is no outer factor, all of it: `(batch, coefficient, control)`.
        values: the entries `(batch, entry)` of the outer factor, or None.
        pattern: where they stand, or None.
    """

    inner: Tensor
    values: Tensor | None = None
    pattern: Pattern | None = None

    def dense(self) -> Tensor:
        """All of it, `(batch, coefficient, control)`."""
        if self.pattern is None:
            return self.inner
        outer = self.inner.new_zeros(len(self.inner), *self.pattern.shape)
        outer[:, self.pattern.rows, self.pattern.columns] = self.values
        return outer @ self.inner

    def times(self, rows: Tensor) -> Tensor:
        """Rows `(row, coefficient)` times the Jacobian of a batch of one: `(row, control)`."""
        if self.pattern is None:
            return rows @ self.inner[0]
        return (self.pattern.transposed(self.values, apart=False) @ rows.T).T @ self.inner[0]

    def pull(self, gradient: Tensor) -> Tensor:
        """A gradient `(batch, coefficient)` as one of the controls, `(batch, control)`."""
        if self.pattern is not None:
            entries = gradient[:, self.pattern.rows] * self.values
            gradient = gradient.new_zeros(len(gradient), self.pattern.shape[1]).index_add_(1, self.pattern.columns, entries)
        return (gradient[:, None] @ self.inner)[:, 0]

    def gram(self, metric: Tensor) -> Tensor:
        """J^T G J `(batch, control, control)` with a symmetric metric G `(coefficient, coefficient)`, dense or sparse."""
        if self.pattern is None:
            return self.inner.transpose(1, 2) @ _times(metric, self.inner)
        pieces = zip(self.values.split(PIECE), self.inner.split(PIECE))
        return torch.cat([self._gram(metric, *piece) for piece in pieces])

    def _gram(self, metric: Tensor, values: Tensor, inner: Tensor) -> Tensor:
        coefficients, shapes = self.pattern.shape
        half = (self.pattern.transposed(values, apart=False) @ metric).view(-1, shapes, coefficients)
        half = half.transpose(1, 2).reshape(-1, shapes)
        middle = (self.pattern.transposed(values, apart=True) @ half).view(-1, shapes, shapes)
        return inner.transpose(1, 2) @ (middle @ inner)


def forward_jacobian(function: Callable[[Tensor], Tensor], controls: Tensor) -> tuple[Tensor, Jacobian]:
    """The coefficients of controls `(batch, control)`, and their derivative, in forward mode: quick where controls are few.

    Args:
        function: controls `(batch, control)` to coefficients `(batch, coefficient)`, each row by itself.
    """
    count = controls.shape[1]
    found, derivatives = [], []
    for batch in controls.detach().split(max(1, FORWARD // count)):
        with forward_ad.dual_level():
            directions = torch.eye(count).to(batch).repeat(len(batch), 1)
            with warnings.catch_warnings():  # on first use PyTorch compiles something in a way that it calls deprecated
                warnings.simplefilter("ignore", DeprecationWarning)
                dual = forward_ad.make_dual(batch.repeat_interleave(count, dim=0), directions)
            values, tangents = forward_ad.unpack_dual(function(dual))
        found.append(values[::count])
        tangents = torch.zeros_like(values) if tangents is None else tangents
        derivatives.append(tangents.unflatten(0, (len(batch), count)).transpose(1, 2))
    return torch.cat(found), Jacobian(torch.cat(derivatives))


def _times(metric: Tensor, columns: Tensor) -> Tensor:
    """A metric, which may be sparse, times `(batch, coefficient, column)`."""
    if not metric.is_sparse_csr:
        return metric @ columns
    batch, coefficients, count = columns.shape
    together = columns.permute(1, 2, 0).reshape(coefficients, -1)
    return (metric @ together).view(coefficients, count, batch).permute(2, 0, 1)
