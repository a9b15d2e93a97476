"""A mesh space in which some vertices count more than others, exactly.

With W the weights of the vertices, W^(1/2) B = Q R and z = Q^T W^(1/2) (x - rest) the weighted squared error is again
|z - R (f(r) - f(neutral))|^2, constant aside: every solver works in it unchanged.
"""

import torch
from torch import Tensor

from riginv.mesh_space import RANK_TOLERANCE, MeshSpace
from riginv.rig import LinearRig


def weighted_space(rig: LinearRig, weights: Tensor) -> MeshSpace:
    """The mesh space of a rig whose vertices count by `weights` `(vertex,)`.

    Its frame is Q^T W^(1/2): good for encoding, and for the rig's linear map; its rows are not orthonormal, so that decoding
    with it means nothing.
    """
    roots = weights.double().sqrt()[:, None]
    rows = (rig.basis.double() * roots).flatten(1)
    squares, vectors = torch.linalg.eigh(rows @ rows.T)
    values = squares.clamp_min(0).sqrt()
    kept = (values > RANK_TOLERANCE**0.5 * values.amax()).nonzero()[:, 0].flip(0)
    frame = (vectors[:, kept] / values[kept]).T @ rows
    frame = torch.linalg.qr(frame.T)[0].T  # once more: the Gram matrix has squared the faint ones' rounding errors
    return MeshSpace(rig.rest_vertices, (frame.unflatten(1, rig.rest_vertices.shape) * roots).to(rig.dtype))
