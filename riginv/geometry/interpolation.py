"""Discrete empirical interpolation: the few vertices of a mesh that determine its coefficients in a basis.

A QR decomposition with pivoting selects them greedily, each the one that those before determine least.

Source: Drmac and Gugercin, "A New Selection Operator for the Discrete Empirical Interpolation Method", 2016.
"""

import numpy as np
import scipy
import torch
from jaxtyping import Float, Int
from torch import Tensor

from riginv.geometry.neighbours import evenly

CANDIDATES = 4000  # vertices to select from, at most
MORE = 1.0  # further vertices for each selected one, evenly spread: they average out components outside the span


def informative_vertices(frame: Float[Tensor, "coefficient vertex 3"]) -> Int[Tensor, " row"]:
    """Vertices `(row,)`, in ascending order, that determine the coefficients of meshes.

    Args:
        frame: the basis, rows orthonormal.
    """
    candidates = evenly(CANDIDATES, frame.shape[1])
    columns = frame[:, candidates.to(frame.device)].flatten(1).double().cpu().numpy()
    _, order = scipy.linalg.qr(columns, mode="r", pivoting=True)
    chosen = candidates.numpy()[np.unique(order[: len(frame)] // 3)]
    more = evenly(int(MORE * len(chosen)), frame.shape[1]).numpy()
    return torch.from_numpy(np.union1d(chosen, more)).to(frame.device)


def coefficients_from(
    frame: Float[Tensor, "coefficient vertex 3"], rows: Int[Tensor, " row"]
) -> Float[Tensor, "number coefficient"]:
    """The matrix `(3 * row, coefficient)` from the coordinates of some vertices to coefficients, by least squares.

    Args:
        frame: as for `informative_vertices`.
        rows: vertices.
    """
    return torch.linalg.pinv(frame[:, rows].flatten(1).double()).to(frame)
