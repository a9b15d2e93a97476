"""What the autograd functions of compiled kernels share."""

from collections.abc import Callable

import torch
from torch import Tensor

from riginv.kernels.library import pure_torch


def pure_gradients(function: Callable[[Tensor], Tensor], given: Tensor, gradient: Tensor) -> Tensor:
    """A gradient of `function(given)` as one of `given` that has derivatives itself: by PyTorch alone."""
    with pure_torch(), torch.enable_grad():
        return torch.autograd.grad(function(given), given, gradient, create_graph=True)[0]
