"""Rigid motion between two meshes, robustly: vertices that move on their own count little.

No skin moves with the skull exactly, so that a plain least-squares fit follows the jaw and the brows. Here each vertex counts
by how still the rig keeps it, and by how well it is hit: iteratively reweighted least squares with the weights of Geman and
McClure (1987). Fitting to the mesh that the controls make, again and again, takes away what bias is left.
"""

import roma
import torch
from torch import Tensor

ROUNDS = 8  # of reweighting, from nothing
MORE_ROUNDS = 3  # from motions that are nearly right
SCALE = 3.0  # times the median distance: where a vertex starts to count little
LEAST_SCALE_MM = 0.05
SETTLED_MM = 1e-3  # on average, that another round still moves the vertices by


def fit_rigid(source: Tensor, target: Tensor, weights: Tensor, start: Tensor | None = None) -> Tensor:
    """The rigid motions that bring meshes `(frame, vertex, 3)` onto others, as matrices `(frame, 4, 4)`, mm.

    Args:
        source: `(frame, vertex, 3)`, or one mesh for all `(1, vertex, 3)`.
        target: `(frame, vertex, 3)`; vertices with NaN count nothing.
        weights: how much each vertex counts, `(vertex,)`.
        start: motions that are nearly right, `(frame, 4, 4)`.

    Returns:
        motions; identities where fewer than three vertices are known.
    """
    known = torch.isfinite(target).all(dim=2)
    base = weights * known
    target = torch.where(known[..., None], target, 0.0)
    source = source.expand_as(target)
    if start is None:
        turn, move = roma.rigid_points_registration(source, target, base)
    else:
        turn, move = start[:, :3, :3], start[:, :3, 3]
    at = source @ turn.mT + move[:, None]
    for _ in range(ROUNDS if start is None else MORE_ROUNDS):
        distance = (at - target).norm(dim=2)
        typical = torch.where(known, distance, torch.nan).nanmedian(dim=1).values
        scale = (SCALE * typical.nan_to_num(0.0)).clamp_min(LEAST_SCALE_MM)[:, None]
        turn, move = roma.rigid_points_registration(source, target, base / (1 + (distance / scale) ** 2) ** 2)
        before, at = at, source @ turn.mT + move[:, None]
        if float((at - before).norm(dim=2).mean(dim=1).max()) < SETTLED_MM:
            break
    motion = torch.eye(4).to(turn).expand(len(turn), -1, -1).clone()
    enough = (base > 0).sum(dim=1) >= 3
    motion[enough, :3, :3], motion[enough, :3, 3] = turn[enough], move[enough]
    return motion


def apply_motion(motion: Tensor, vertices: Tensor) -> Tensor:
    """Meshes `(frame, vertex, 3)` after motions `(frame, 4, 4)`."""
    return vertices @ motion[:, :3, :3].mT + motion[:, None, :3, 3]


def remove_motion(motion: Tensor, vertices: Tensor) -> Tensor:
    """Meshes `(frame, vertex, 3)` before motions `(frame, 4, 4)`: the inverse of `moved`."""
    return (vertices - motion[:, None, :3, 3]) @ motion[:, :3, :3]
