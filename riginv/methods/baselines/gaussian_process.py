"""Gaussian-process regression with an unknown constant mean, its scales chosen by leaving one out."""

import torch
from torch import Tensor

WIDTHS = (1.0, 4.0, 16.0)  # of the kernel, as multiples of the median distance
NOISES = (1e-4, 1e-3, 1e-2)  # variance of the noise, relative to the kernel's scale


class GaussianProcess:
    """From inputs `(sample, input)` to outputs `(sample, output)`, all with the same multiquadric kernel.

    The multiquadric is no covariance, only a conditional one: its negative is positive definite for weights that add up to 0.
    So a constant is fitted along, under that condition: universal kriging. Width and noise are those of a small grid that
    predict each sample best from all the others, which the inverse gives in closed form.

    Attributes:
        left_out: the root mean square error of the outputs when each sample is predicted from the others.
    """

    def __init__(self, inputs: Tensor, outputs: Tensor) -> None:
        self.inputs, outputs = inputs.double(), outputs.double()
        squares = torch.cdist(self.inputs, self.inputs).square()
        count = len(squares)
        apart = squares[~torch.eye(count, dtype=torch.bool)]
        self.scale = float(apart.median().sqrt()) if len(apart) else 1.0
        self.scale = self.scale or 1.0
        right = torch.cat([outputs, outputs.new_zeros(1, outputs.shape[1])])
        self.left_out = torch.inf
        for width in WIDTHS:
            kernel = -(squares / self.scale**2 + width**2).sqrt()
            for noise in NOISES:
                border = kernel.new_ones(count, 1)
                upper = torch.cat([kernel + noise * torch.eye(count, dtype=torch.float64), border], dim=1)
                system = torch.cat([upper, torch.cat([border, border.new_zeros(1, 1)]).T])
                inverse = torch.linalg.pinv(system) if count < 3 else torch.linalg.inv(system)
                weights = inverse @ right
                errors = weights[:count] / inverse.diagonal()[:count, None].clamp_min(torch.finfo(torch.float64).tiny)
                error = float(errors.square().mean().sqrt())
                if error < self.left_out:
                    self.left_out, self.width, self.weights = error, width, weights

    def __call__(self, inputs: Tensor) -> Tensor:
        """The expected outputs `(mesh, output)` for inputs `(mesh, input)`."""
        squares = torch.cdist(inputs.double(), self.inputs).square()
        kernel = -(squares / self.scale**2 + self.width**2).sqrt()
        return kernel @ self.weights[:-1] + self.weights[-1]


class PrincipalComponents:
    """A linear map from mesh coordinates to a few numbers that distinguish samples.

    Args:
        samples: `(sample, coordinate)`.
        share: of the samples' variance that is kept.
        view: `(coordinate, seen)`: what of the coordinates is looked at; None: all.
    """

    def __init__(self, samples: Tensor, share: float, view: Tensor | None = None) -> None:
        seen = samples.double() if view is None else samples.double() @ view.double()
        self.mean = seen.mean(dim=0)
        _, sizes, directions = torch.linalg.svd(seen - self.mean, full_matrices=False)
        variance = sizes.square().cumsum(0)
        count = int((variance < share * variance[-1]).sum()) + 1
        self.map = directions[:count].T if view is None else view.double() @ directions[:count].T
        self.offset = self.mean @ directions[:count].T

    def __call__(self, coordinates: Tensor) -> Tensor:
        """Mesh coordinates `(mesh, coordinate)` as `(mesh, component)`."""
        return coordinates.double() @ self.map - self.offset
