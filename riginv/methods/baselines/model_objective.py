"""The squared distance of an approximate rig from a mesh, as an objective for the solvers of `riginv.solvers`."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from riginv.methods.baselines.product_model import ProductModel
from riginv.solvers.objective import Linearised, Result


class ModelObjective:
    """The unknowns are the weights of sides, `(mesh, side)` in [0, 1], in float64.

    Not the controls: the two ways out of neutral often move different shapes, so that the derivative one way says nothing of
    the other way, and a solver that starts at neutral would not find it. With a weight for each way the limit at 0 decides.

    Args:
        vertex_count: of the mesh.
        prior: mm^2, as the mean over the vertices, for a weight of 1: it settles which of several controls for one motion is
            taken, and keeps one that does nothing at neutral.
        sparsity: the same, in proportion to the weight: a weight is not negative, so the penalty has no corner inside.
    """

    gradient_steps = 0

    def __init__(self, model: ProductModel, vertex_count: int, prior: float, sparsity: float = 0.0) -> None:
        self.model, self.squared_mm = model, vertex_count  # of a mean squared distance of 1 mm^2
        self.prior, self.sparsity = prior * vertex_count, sparsity * vertex_count
        self.neutral = torch.zeros(len(model.sides), dtype=torch.float64)

    def run_tasks(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """The results of tasks that evaluate this objective, one after the other."""
        return [task() for task in tasks]

    def cost(self, weights: Tensor, coordinates: Tensor) -> Tensor:
        """The objective `(mesh,)`."""
        residual = self.model.coordinates(weights) - coordinates
        return 0.5 * residual.square().sum(dim=1) + self._penalty(weights)

    def gradient(self, weights: Tensor, coordinates: Tensor) -> Tensor:
        """The gradient `(mesh, side)` of the objective."""
        return self.linearise(weights, coordinates).gradient

    def linearise(self, weights: Tensor, coordinates: Tensor) -> Linearised:
        """The objective with its gradient and Gauss-Newton Hessian, all from the approximation."""
        found, jacobian = self.model.linearised(weights)
        residual = found - coordinates
        cost = 0.5 * residual.square().sum(dim=1) + self._penalty(weights)
        gradient = (jacobian @ residual[:, :, None])[..., 0] + self.prior * weights + self.sparsity
        hessian = jacobian @ jacobian.transpose(1, 2)
        hessian.diagonal(dim1=1, dim2=2).add_(self.prior)
        return Linearised(cost, gradient, hessian)

    def _penalty(self, weights: Tensor) -> Tensor:
        return 0.5 * self.prior * weights.square().sum(dim=1) + self.sparsity * weights.sum(dim=1)
