"""The squared distance of an approximate rig from a mesh, as the solvers of `riginv.solvers` want it."""

from torch import Tensor

from riginv.baselines.product_model import ProductModel
from riginv.solvers.objective import Linearised


class ModelObjective:
    """Controls are shares of their ranges, 0 at the lower limit and 1 at the upper, in float64.

    Args:
        prior: mm^2, over all vertices, for one control that leaves neutral by its whole range: it settles which
            of several controls for one motion is taken, and keeps one that does nothing at neutral.
    """

    def __init__(self, model: ProductModel, prior: float) -> None:
        self.model, self.sides, self.prior = model, model.sides, prior
        self.neutral = self.sides.units(self.sides.neutral)

    def cost(self, units: Tensor, coordinates: Tensor) -> Tensor:
        """The objective `(mesh,)` at shares `(mesh, control)`."""
        weights, _ = self.sides.of_units(units)
        residual = self.model.coordinates(weights) - coordinates
        return 0.5 * residual.square().sum(dim=1) + self._away(units)

    def linearise(self, units: Tensor, coordinates: Tensor) -> Linearised:
        """The objective with its gradient and Gauss-Newton Hessian, all from the approximation."""
        weights, slopes = self.sides.of_units(units)
        found, by_weight = self.model.linearised(weights)
        jacobian = units.new_zeros(len(units), len(self.neutral), found.shape[1])
        jacobian.index_add_(1, self.sides.control, by_weight * slopes[:, :, None])
        residual = found - coordinates
        gradient = (jacobian @ residual[:, :, None])[..., 0] + self.prior * (units - self.neutral)
        hessian = jacobian @ jacobian.transpose(1, 2)
        hessian.diagonal(dim1=1, dim2=2).add_(self.prior)
        return Linearised(0.5 * residual.square().sum(dim=1) + self._away(units), gradient, hessian)

    def controls(self, units: Tensor) -> Tensor:
        """Shares of ranges as controls `(mesh, control)`, exactly within the limits."""
        own = self.sides.lower + self.sides.span * units
        return own.to(self.sides.dtype).clamp(*self.sides.limits)

    def _away(self, units: Tensor) -> Tensor:
        return 0.5 * self.prior * (units - self.neutral).square().sum(dim=1)
