"""Sums of entries by column: what the gradient of picking columns is."""

from torch import Tensor

from riginv.kernels.library import kernels_for, plain_rows


def add_to_columns(sums: Tensor, columns: Tensor, entries: Tensor, scales: Tensor | None = None) -> Tensor:
    """Add entries `(batch, entry)`, each times its scale, to the columns `(entry,)` of `sums` `(batch, column)`, in place."""
    compiled = kernels_for(sums, columns, entries) if scales is None else kernels_for(sums, columns, entries, scales)
    if compiled is None:
        return sums.index_add_(1, columns, entries if scales is None else entries * scales)
    entries, scales = plain_rows(entries), None if scales is None else plain_rows(scales)
    scale_stride = 0 if scales is None else scales.stride(0)
    given = (entries, entries.stride(0), scales, scale_stride, columns.contiguous(), len(columns))
    compiled.call("add_to_columns", sums.dtype, *given, sums, sums.stride(0), len(sums))
    return sums
