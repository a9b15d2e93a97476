"""The Jacobian of a rig's nonlinear part, as a product of sparse matrices.

Each step of a rig's logic depends on few values of the step before: a corrective on the weights of two or three shapes, a shape
on a few controls. So d coefficients / d controls is a product of sparse matrices with fixed patterns.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd import forward_ad

from riginv.geometry.blendshapes import add_to_columns
from riginv.geometry.kernels.library import Kernels, kernels_for

STEP = 1e-3  # of a control's range, between the two ends of a finite difference
FORWARD = 1024  # rows of a batch in forward mode, one for each control of each pose
BATCH_SIZE = 16  # Jacobians at a time: they fit a processor's cache

# Only products of a sparse and a dense matrix are used here.
warnings.filterwarnings("ignore", message=".*Sparse CSR tensor support is in beta state.*")


class Pattern:
    """The positions of the entries of a sparse matrix `(row, column)`.

    Args:
        rows, columns: `(entry,)`, in any order; entries at the same position add up, those of column -1 are dropped.
        shape: of the matrix.

    Attributes:
        kept: the indices of the entries that were not dropped, `(entry,)`.
    """

    def __init__(self, rows: Tensor, columns: Tensor, shape: tuple[int, int]) -> None:
        self.kept = (columns >= 0).nonzero()[:, 0]
        rows, columns = rows[self.kept], columns[self.kept]
        self.shape, self.rows, self.columns = shape, rows, columns
        self.order = torch.argsort(columns * shape[0] + rows)  # row by row of the transpose
        counts = torch.bincount(columns, minlength=shape[1])
        self.starts = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
        self.rows_in_order = rows[self.order]

    def transposed(self, values: Tensor, block_diagonal: bool) -> Tensor:
        """The transposes of matrices with entries `values` `(batch, entry)`, as one sparse matrix.

        Args:
            block_diagonal: whether they are the blocks of a block-diagonal matrix, or stacked one below the other.
        """
        batch, (coefficients, shapes) = len(values), self.shape
        number = torch.arange(batch, device=values.device)[:, None]
        starts = torch.cat([self.starts[:1], (self.starts[1:] + number * len(self.rows)).flatten()])
        columns = (self.rows_in_order + number * (coefficients if block_diagonal else 0)).flatten()
        size = (batch * shapes, coefficients * (batch if block_diagonal else 1))
        return torch.sparse_csr_tensor(starts, columns, values[:, self.order].flatten(), size=size, check_invariants=False)


@dataclass(frozen=True)
class Factor:
    """A batch of sparse matrices `(row, column)` of one pattern.

    Attributes:
        pattern: the positions of the entries.
        values: the entries, `(batch, entry)`.
    """

    pattern: Pattern
    values: Tensor

    def times(self, columns: Tensor) -> Tensor:
        """The product with dense matrices: `(batch, column, other)` to `(batch, row, other)`."""
        result = columns.new_zeros(len(columns), self.pattern.shape[0], columns.shape[2])
        return result.index_add_(1, self.pattern.rows, self.values[..., None] * columns[:, self.pattern.columns])

    def vjp(self, gradient: Tensor) -> Tensor:
        """The vector-Jacobian product: a gradient `(batch, row)` to one `(batch, column)`."""
        sums = gradient.new_zeros(len(gradient), self.pattern.shape[1])
        return add_to_columns(sums, self.pattern.columns, gradient.index_select(1, self.pattern.rows), self.values)

    def dense(self) -> Tensor:
        """As dense matrices, `(batch, row, column)`."""
        return self.times(torch.eye(self.pattern.shape[1]).to(self.values).expand(len(self.values), -1, -1))


@dataclass(frozen=True)
class Jacobian:
    """d coefficients / d controls of a batch, `(batch, coefficient, control)`: a product of sparse factors and a dense one.

    Attributes:
        factors: sparse; the rows of the first are the coefficients.
        inner: dense, `(batch, column of the last factor, control)`; without factors it is the whole Jacobian. None: the columns
            of the last factor are the controls.
    """

    factors: tuple[Factor, ...] = ()
    inner: Tensor | None = None

    def dense(self) -> Float[Tensor, "batch coefficient control"]:
        """As dense matrices, `(batch, coefficient, control)`."""
        outer, result = (self.factors, self.inner) if self.inner is not None else (self.factors[:-1], self.factors[-1].dense())
        for factor in reversed(outer):
            result = factor.times(result)
        return result

    def times(self, rows: Float[Tensor, "row coefficient"]) -> Float[Tensor, "row control"]:
        """Rows `(row, coefficient)` times the Jacobian of a batch of one: `(row, control)`."""
        for factor in self.factors:
            rows = (factor.pattern.transposed(factor.values, block_diagonal=False) @ rows.T).T
        return rows if self.inner is None else rows @ self.inner[0]

    def times_each(self, rows: Float[Tensor, "batch row coefficient"]) -> Float[Tensor, "batch row control"]:
        """Rows of each pose times its Jacobian: `(batch, row, coefficient)` to `(batch, row, control)`."""
        columns = rows.mT
        for factor in self.factors:
            batch, size, count = columns.shape
            blocks = factor.pattern.transposed(factor.values, block_diagonal=True)
            columns = (blocks @ columns.reshape(batch * size, count)).view(batch, -1, count)
        return columns.mT if self.inner is None else columns.mT @ self.inner

    def vjp(self, gradient: Float[Tensor, "batch coefficient"]) -> Float[Tensor, "batch control"]:
        """The vector-Jacobian product: a gradient `(batch, coefficient)` to one of the controls, `(batch, control)`."""
        for factor in self.factors:
            gradient = factor.vjp(gradient)
        return gradient if self.inner is None else (gradient[:, None] @ self.inner)[:, 0]

    def of_controls(self, controls: Int[Tensor, " control"]) -> "Jacobian":
        """The derivative by some of the controls alone, by their indices `(control,)`."""
        if self.inner is not None:
            return Jacobian(self.factors, self.inner[..., controls])
        last = self.factors[-1]
        index = torch.full((last.pattern.shape[1],), -1, device=controls.device)
        index[controls] = torch.arange(len(controls), device=controls.device)
        pattern = Pattern(last.pattern.rows, index[last.pattern.columns], (last.pattern.shape[0], len(controls)))
        return Jacobian((*self.factors[:-1], Factor(pattern, last.values[:, pattern.kept])))

    def scaled(self, scale: Float[Tensor, " control"]) -> "Jacobian":
        """The derivative by each control multiplied by `scale` `(control,)`."""
        if self.inner is not None:
            return Jacobian(self.factors, self.inner * scale)
        last = self.factors[-1]
        return Jacobian((*self.factors[:-1], Factor(last.pattern, last.values * scale[last.pattern.columns])))

    def gram(self, metric: Tensor) -> Tensor:
        """J^T G J `(batch, control, control)` with a symmetric metric G `(coefficient, coefficient)`, dense or sparse."""
        if not self.factors:
            inner = self.dense()
            return inner.transpose(1, 2) @ _times(metric, inner)
        compiled = None if metric.is_sparse_csr else kernels_for(metric, self.factors[0].values)
        if compiled is not None:
            metric = _sandwich(compiled, metric, self.factors)
            return metric if self.inner is None else self.inner.transpose(1, 2) @ (metric @ self.inner)
        outer, inner = self.factors[0], Jacobian(self.factors[1:], self.inner).dense()
        batches = zip(outer.values.split(BATCH_SIZE), inner.split(BATCH_SIZE))
        return torch.cat([_gram(metric, outer.pattern, *batch) for batch in batches])


def _sandwich(compiled: Kernels, metric: Tensor, factors: Sequence[Factor]) -> Tensor:
    """... F2^T F1^T G F1 F2 ..., `(batch, column, column)`, for the columns of the last factor."""
    values = [factor.values[:, factor.pattern.order] for factor in factors]  # the kernel reads their memory
    table = torch.tensor(
        [
            [*pattern.shape, each.shape[1], *(part.data_ptr() for part in (each, pattern.rows_in_order, pattern.starts))]
            for each, pattern in zip(values, (factor.pattern for factor in factors))
        ]
    )
    columns = factors[-1].pattern.shape[1]
    result = metric.new_empty(len(values[0]), columns, columns)
    compiled.call("sandwich", metric.dtype, metric.contiguous(), table, len(factors), result, len(result))
    return result


def _gram(metric: Tensor, pattern: Pattern, values: Tensor, inner: Tensor) -> Tensor:
    coefficients, shapes = pattern.shape
    half = (pattern.transposed(values, block_diagonal=False) @ metric).view(-1, shapes, coefficients)
    half = half.transpose(1, 2).reshape(-1, shapes)
    middle = (pattern.transposed(values, block_diagonal=True) @ half).view(-1, shapes, shapes)
    return inner.transpose(1, 2) @ (middle @ inner)


def forward_jacobian(
    function: Callable[[Tensor], Tensor], controls: Float[Tensor, "batch control"]
) -> tuple[Float[Tensor, "batch coefficient"], Jacobian]:
    """The coefficients of controls `(batch, control)`, and their Jacobian, in forward mode: fast where controls are few.

    Args:
        function: controls `(batch, control)` to coefficients `(batch, coefficient)`, row by row.
    """
    count = controls.shape[1]
    found, derivatives = [], []
    for batch in controls.detach().split(max(1, FORWARD // count)):
        with forward_ad.dual_level():
            directions = torch.eye(count).to(batch).repeat(len(batch), 1)
            with warnings.catch_warnings():  # PyTorch itself uses a deprecated function here
                warnings.simplefilter("ignore", DeprecationWarning)
                dual = forward_ad.make_dual(batch.repeat_interleave(count, dim=0), directions)
            values, tangents = forward_ad.unpack_dual(function(dual))
        found.append(values[::count])
        tangents = torch.zeros_like(values) if tangents is None else tangents
        derivatives.append(tangents.unflatten(0, (len(batch), count)).transpose(1, 2))
    return torch.cat(found), Jacobian(inner=torch.cat(derivatives))


@torch.no_grad()
def finite_differences(
    function: Callable[[Tensor], Tensor],
    controls: Float[Tensor, "batch control"],
    lower: Float[Tensor, " control"],
    upper: Float[Tensor, " control"],
) -> tuple[Float[Tensor, "batch coefficient"], Jacobian]:
    """A function of controls `(batch, control)`, and its Jacobian by one-sided differences within the limits `(control,)`."""
    step = STEP * (upper - lower).to(controls)
    step = torch.where(controls + step <= upper.to(controls), step, -step)
    found = function(controls)
    moved = [function(controls + step * column) for column in torch.eye(controls.shape[1]).to(controls)]
    return found, Jacobian(inner=(torch.stack(moved, dim=2) - found[:, :, None]) / step[:, None])


def _times(metric: Tensor, columns: Tensor) -> Tensor:
    """A metric, which may be sparse, times `(batch, coefficient, column)`."""
    if not metric.is_sparse_csr:
        return metric @ columns
    batch, coefficients, count = columns.shape
    together = columns.permute(1, 2, 0).reshape(coefficients, -1)
    return (metric @ together).view(coefficients, count, batch).permute(2, 0, 1)
