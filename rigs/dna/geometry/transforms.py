"""Affine transforms with the batch last, `(joint, 3, 4, batch)`: products of thousands of tiny matrices, one entry at a time.

`riginv.geometry.kinematics` has the batch first and multiplies matrix by matrix, which costs several times as much where
there are hundreds of joints.
"""

import torch
from torch import Tensor


def apply(outer: Tensor, inner: Tensor) -> Tensor:
    """The products `(joint, 3, column, batch)` of matrices `(joint, 3, 3, batch)` with `(joint, 3, column, batch)`."""
    product = outer[:, :, 0, None] * inner[:, None, 0]
    for column in (1, 2):
        product = torch.addcmul(product, outer[:, :, column, None], inner[:, None, column])
    return product


def follow(outer: Tensor, inner: Tensor) -> Tensor:
    """The transforms `(joint, 3, 4, batch)` that apply `inner` first, then `outer`."""
    product = apply(outer, inner)
    return torch.cat([product[:, :, :3], product[:, :, 3:] + outer[:, :, 3:]], dim=2)
