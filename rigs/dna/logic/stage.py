"""The base of everything that is computed from a file's numbers."""

import numpy as np
import torch
from torch import Tensor, nn


class Stage(nn.Module):
    """A module that holds facts, in buffers which are no part of its state, and nothing that is trained."""

    def keep(self, **values: Tensor | np.ndarray) -> None:
        """Register buffers; indices become int64, other numbers stay as they are."""
        for name, value in values.items():
            tensor = torch.as_tensor(np.array(value)) if isinstance(value, np.ndarray) else value
            self.register_buffer(name, tensor if tensor.is_floating_point() else tensor.long(), persistent=False)


def put(controls: Tensor, indices: Tensor, values: Tensor) -> Tensor:
    """A copy of controls `(batch, control)` in which those of `indices` have other values `(batch, index)`."""
    return controls.index_copy(1, indices, values)
