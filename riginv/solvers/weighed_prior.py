"""How likely controls are together, as a quadratic cost beside squared distances."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class WeighedPrior:
    """`0.5 (u - mean)' precision (u - mean)`, mm^2, for controls u in fractions of their ranges.

    Attributes:
        mean: `(control,)`.
        precision: `(control, control)`, mm^2.
    """

    mean: Tensor
    precision: Tensor

    def scaled(self, factor: float, dtype: torch.dtype) -> "WeighedPrior":
        """The same, times a factor, in a dtype."""
        return WeighedPrior(self.mean.to(dtype), (factor * self.precision).to(dtype))

    def cost(self, units: Tensor) -> Tensor:
        """`(mesh,)`, of controls `(mesh, control)`."""
        away = units - self.mean.to(units)
        return 0.5 * (away * (away @ self.precision.to(units))).sum(dim=-1)

    def gradient(self, units: Tensor) -> Tensor:
        """`(mesh, control)`."""
        return (units - self.mean.to(units)) @ self.precision.to(units)
