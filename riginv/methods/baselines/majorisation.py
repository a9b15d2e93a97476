"""Rackovic et al.: majorisation-minimisation on a quadratic rig."""

import torch
from torch import Tensor

from riginv.config.values import NonNegativeFloat, NonNegativeInt, PositiveInt
from riginv.methods.base import BatchedMethod
from riginv.methods.baselines.measured import ramps, with_products
from riginv.methods.baselines.product_model import NONE, ProductModel
from riginv.rig.mesh_space import RigInMeshSpace

STRIDES = (2.0, 5.0, 10.0, 20.0, 50.0)  # multiples of a step that are tried, as the published scripts do


class Majoriser:
    """Steps that minimise a separable upper bound of the objective, all weights at once; the objective never rises.

    With residual e, Jacobian J (the full product rule) and the quadratic part q(v) of a step v,

        |e + J v + q(v)|^2 - |e|^2  <=  2 e^T J v + 2 e^T q(v) + 2 |J v|^2 + 2 |q(v)|^2,

    and each of the last three is bounded by sums over single weights: e^T q(v) through 2 v_s v_t <= v_s^2 + v_t^2, |J v|^2
        through the row sums of |J^T J|, |q(v)|^2 through the greatest eigenvalue of the products' Gram matrix, once and for
        all. What remains is a convex polynomial a v + b v^2 + c v^4 for each weight, with a closed-form minimum.

    Args:
        model: of second order: ramps, squares of them and products of two.
        sparsity: penalty on the sum of the weights (the published lambda).
    """

    def __init__(self, model: ProductModel, sparsity: float) -> None:
        self.model, self.sparsity = model, sparsity
        second = (model.members != NONE).sum(dim=1) == 2
        self.products = second.nonzero()[:, 0]
        self.pair = model.in_slot[self.products][:, :2]
        deltas = model.deltas[self.products]
        self.degree = torch.zeros(len(model.sides), dtype=torch.float64)
        greatest = torch.zeros((), dtype=torch.float64)
        if len(self.products):
            greatest = torch.linalg.matrix_norm(deltas, ord=2).square()
            half = torch.full((len(self.pair),), 0.5, dtype=torch.float64)
            for slot in (0, 1):
                self.degree.index_add_(0, self.pair[:, slot], half)
        self.fourth = 2 * greatest * self.degree

    def cost(self, weights: Tensor, coordinates: Tensor) -> Tensor:
        """The squared distance plus the penalty, `(mesh,)`."""
        distance = self.model.coordinates(weights) - coordinates
        return distance.square().sum(dim=1) + self.sparsity * weights.sum(dim=1)

    def __call__(self, weights: Tensor, coordinates: Tensor, iterations: int, tolerance: float) -> Tensor:
        """Weights `(mesh, side)` after so many steps, or when no mesh gains more than the fraction `tolerance` in one."""
        cost = self.cost(weights, coordinates)
        for _ in range(iterations):
            step = self._step(weights, coordinates)
            best, least = weights, cost
            for stride in (1.0, *STRIDES):
                tried = (weights + stride * step).clamp(0, 1)
                found = self.cost(tried, coordinates)
                better = found < least
                best, least = torch.where(better[:, None], tried, best), torch.where(better, found, least)
            gained = bool((cost - least > tolerance * cost).any())
            weights, cost = best, least
            if not gained:
                break
        return weights

    def _step(self, weights: Tensor, coordinates: Tensor) -> Tensor:
        found, jacobian = self.model.linearised(weights)
        residual = found - coordinates
        first = 2 * (jacobian @ residual[..., None])[..., 0] + self.sparsity
        second = 2 * (jacobian @ jacobian.transpose(1, 2)).abs().sum(dim=2)
        pull = (residual @ self.model.deltas[self.products].T).abs()
        for slot in (0, 1):
            second.index_add_(1, self.pair[:, slot], pull)
        step = _least(first, second, self.fourth.expand_as(first))
        return (weights + step).clamp(0, 1) - weights


def _least(first: Tensor, second: Tensor, fourth: Tensor) -> Tensor:
    """The minimum of a v + b v^2 + c v^4, for b, c >= 0: the one root of a + 2 b v + 4 c v^3; 0 where b and c vanish."""
    tiny = torch.finfo(first.dtype).tiny ** 0.5
    straight = torch.where(second > tiny, -first / (2 * second).clamp_min(tiny), 0.0)
    p, q = second / (2 * fourth.clamp_min(tiny)), first / (4 * fourth.clamp_min(tiny))
    root = (p / 3).sqrt()
    cubic = -2 * root * torch.sinh(torch.asinh(1.5 * q / (p * root).clamp_min(tiny)) / 3)
    return torch.where((fourth > tiny) & (second > tiny), cubic, straight)


class MajorisationMinimisation(BatchedMethod):
    """Majorisation-minimisation from neutral.

    Args:
        pairs: products of two controls that are kept, the strongest.
        iterations: steps, at most.
        sparsity: penalty on the sum of the weights, mm^2 of mean squared error for a weight of 1.
        tolerance: steps end once no mesh of a batch gains more than this fraction of its objective in one.
    """

    source = (
        "Rackovic, Soares, Jakovetic, Desnica: A majorization-minimization-based method for nonconvex inverse rig "
        "problems in facial animation (arXiv 2205.04289; LMMM). Changed: bounds taken in mesh coordinates and per weight, "
        "where the published ones are per vertex coordinate and shared by all weights, so that steps are longer and no "
        "minute of eigenvalues goes before; the Jacobian has both halves of the product rule, no row is left out, and the "
        "tolerance is relative, so that it is passed; squares of single controls; the published strides of 5 to 50 are "
        "kept, and 2 is added."
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        pairs: NonNegativeInt = 1000,
        iterations: PositiveInt = 150,
        sparsity: NonNegativeFloat = 1e-4,
        tolerance: float = 1e-4,
    ) -> None:
        super().__init__(rig)
        self.pairs, self.iterations, self.tolerance = pairs, iterations, tolerance
        self.sparsity = sparsity * rig.space.vertex_count

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        self.majoriser = Majoriser(with_products(self.rig, ramps(self.rig, squares=True), [self.pairs]), self.sparsity)

    def solve(self, coordinates: Tensor) -> Tensor:
        sides = self.majoriser.model.sides
        start = torch.zeros(len(coordinates), len(sides), dtype=torch.float64)
        return sides.controls(self.majoriser(start, coordinates.double(), self.iterations, self.tolerance))
