"""Sparse-dense matrix products, differentiable in the dense factor in both modes, also under vmap."""

import warnings
from typing import Any

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from rigs.dna.logic.layout import Stage

with warnings.catch_warnings():  # PyTorch warns once per process that sparse matrices are in beta
    warnings.simplefilter("ignore")
    torch.sparse_csr_tensor(torch.tensor([0, 1]), torch.tensor([0]), torch.ones(1), size=(1, 1), check_invariants=False)


class _Product(torch.autograd.Function):
    """matrix @ x; the transpose is for the gradient."""

    @staticmethod
    def forward(matrix: tuple[Tensor, ...], transpose: tuple[Tensor, ...], x: Tensor) -> Tensor:
        starts, columns, values = (part.to(x) if part.is_floating_point() else part for part in matrix)
        size = (len(starts) - 1, len(x))
        return torch.sparse_csr_tensor(starts, columns, values, size=size, check_invariants=False) @ x

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple, output: Tensor) -> None:
        ctx.matrix, ctx.transpose, _ = inputs

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, None, Tensor]:
        return None, None, _Product.apply(ctx.transpose, ctx.matrix, gradient.contiguous())

    @staticmethod
    def jvp(ctx: Any, matrix: None, transpose: None, tangent: Tensor) -> Tensor:
        return _Product.apply(ctx.matrix, ctx.transpose, tangent.contiguous())

    @staticmethod
    def vmap(info: Any, in_dims: tuple, matrix: tuple, transpose: tuple, x: Tensor) -> tuple[Tensor, int]:
        moved = x.movedim(in_dims[2], 1)  # (row, vmapped, column)
        found = _Product.apply(matrix, transpose, moved.flatten(1).contiguous())
        return found.unflatten(1, moved.shape[1:]), 1


class SparseMap(Stage):
    """A sparse matrix `(row, column)`.

    Args:
        matrix: in any of scipy's formats; duplicate entries are summed.
    """

    def __init__(self, matrix: sparse.spmatrix | sparse.sparray) -> None:
        super().__init__()
        matrix = sparse.csr_array(matrix)
        matrix.sum_duplicates()
        for name, one in (("of", matrix), ("transposed", sparse.csr_array(matrix.T))):
            for part, values in (("starts", one.indptr), ("columns", one.indices), ("values", one.data)):
                tensor = torch.tensor(values.astype(np.int32 if part != "values" else np.float32))
                self.register_buffer(f"{name}_{part}", tensor, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """The matrix times `(column, number)`: `(row, number)`."""
        matrix, transpose = (
            tuple(self.get_buffer(f"{name}_{part}") for part in ("starts", "columns", "values"))
            for name in ("of", "transposed")
        )
        return _Product.apply(matrix, transpose, x.contiguous())
