"""Meshes some at a time, whatever their number."""

from collections.abc import Callable

import torch
from torch import Tensor


def in_pieces(coordinates: Tensor, size: int, solve: Callable[[Tensor], Tensor], controls: int) -> Tensor:
    """The answers `(mesh, control)` of `solve` for meshes `(mesh, coordinate)`, `size` of them at a time.

    A mesh that holds NaN or infinite values is solved as the rest mesh, and spoils no other.
    """
    whole = torch.isfinite(coordinates).all(dim=1, keepdim=True)
    answers = [solve(piece) for piece in torch.where(whole, coordinates, 0.0).split(size) if len(piece)]
    return torch.cat(answers) if answers else coordinates.new_zeros(0, controls)
