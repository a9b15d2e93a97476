"""Affine transforms with the batch last, `(joint, 3, 4, batch)`: products of thousands of tiny matrices, one entry at a time.

`riginv.geometry.kinematics` has the batch first and multiplies matrix by matrix, which costs several times as much where
there are hundreds of joints.
"""

import torch
from torch import Tensor


def apply(outer: Tensor, inner: Tensor) -> Tensor:
    """The products `(joint, 3, column, batch)` of matrices `(joint, 3, 3, batch)` with `(joint, 3, column, batch)`."""
    columns, rows = outer.unbind(2), inner.unbind(1)  # one step in the gradient, where indexing has one for each index
    product = columns[0][:, :, None] * rows[0][:, None]
    for column, row in zip(columns[1:], rows[1:]):
        product = torch.addcmul(product, column[:, :, None], row[:, None])
    return product


def follow(outer: Tensor, inner: Tensor) -> Tensor:
    """The transforms `(joint, 3, 4, batch)` that apply `inner` first, then `outer`."""
    linear, offsets = outer.split((3, 1), dim=2)
    first, last = apply(linear, inner).split((3, 1), dim=2)
    return torch.cat([first, last + offsets], dim=2)
