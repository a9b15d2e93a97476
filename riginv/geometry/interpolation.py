"""The few vertices of a mesh that tell its coefficients in a basis.

A mesh in the span of a basis is known from as many of its coordinates as the basis has rows, where these are well chosen. A
QR decomposition with pivoting chooses them greedily, each the one that those before tell least about.

Source: Drmac and Gugercin, "A New Selection Operator for the Discrete Empirical Interpolation Method", 2016.
"""

import numpy as np
import torch
from scipy.linalg import qr
from torch import Tensor

from riginv.geometry.neighbours import evenly

CANDIDATES = 4000  # vertices that are chosen from
MORE = 1.0  # so many others for each that was chosen, evenly spread: they average out what lies outside the span


def telling_vertices(frame: Tensor) -> Tensor:
    """Vertices `(row,)`, in ascending order, that tell the coefficients of meshes.

    Args:
        frame: the basis, `(coefficient, vertex, 3)`, rows orthonormal.
    """
    candidates = evenly(CANDIDATES, frame.shape[1])
    columns = frame[:, candidates.to(frame.device)].flatten(1).double().cpu().numpy()
    _, order = qr(columns, mode="r", pivoting=True)
    chosen = candidates.numpy()[np.unique(order[: len(frame)] // 3)]
    more = evenly(int(MORE * len(chosen)), frame.shape[1]).numpy()
    return torch.from_numpy(np.union1d(chosen, more)).to(frame.device)


def coefficients_from(frame: Tensor, rows: Tensor) -> Tensor:
    """The matrix `(3 * row, coefficient)` that makes coefficients, by least squares, of the coordinates of some vertices.

    Args:
        frame: as for `telling_vertices`.
        rows: vertices, `(row,)`.
    """
    return torch.linalg.pinv(frame[:, rows].flatten(1).double()).to(frame)
