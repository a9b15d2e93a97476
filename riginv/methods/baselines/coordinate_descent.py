"""Rackovic et al.: coordinate descent on a multilinear rig, in Gram form."""

import torch
from torch import Tensor

from riginv.config.values import NonNegativeFloat, NonNegativeInt, PositiveInt
from riginv.methods.base import BatchedMethod
from riginv.methods.baselines.measured import ramps, with_products
from riginv.methods.baselines.product_model import ProductModel
from riginv.rig.mesh_space import RigInMeshSpace


class GramDescent:
    """Coordinate descent: one weight after another is set to its minimum with the others fixed, for many meshes at once.

    The mesh is B phi(w) with phi the products of weights, so K = B^T B and b = B^T z hold all that the squared distance
    |B phi - z|^2 depends on: no step touches a vertex. phi is linear in every single weight, so each minimum is exact.

    Args:
        model: its activations are ramps, none of them twice in a term.
        sparsity: penalty on the sum of the weights (the published lambda).
        groups: sides of which only one may leave 0, in the order in which they are visited; None: those of each control.
    """

    def __init__(self, model: ProductModel, sparsity: float, groups: list[list[int]] | None = None) -> None:
        self.model, self.sparsity = model, sparsity
        self.gram = model.deltas @ model.deltas.T
        strength = model.deltas[: len(model.sides)].norm(dim=1).tolist()
        order = sorted(model.sides.groups, key=lambda group: -max(strength[side] for side in group))
        self.groups = groups if groups is not None else order
        self.rows = [self.gram[terms] for terms in model.terms_of_side]
        self.blocks = [rows[:, terms] for rows, terms in zip(self.rows, model.terms_of_side)]
        self.members = [model.members[terms] for terms in model.terms_of_side]
        self.least = torch.finfo(torch.float64).eps * self.gram.diagonal().max().clamp_min(1e-30)

    def cost(self, weights: Tensor, coordinates: Tensor) -> Tensor:
        """Half the squared distance plus the penalty, `(mesh,)`."""
        distance = self.model.coordinates(weights) - coordinates
        return 0.5 * distance.square().sum(dim=1) + self.sparsity * weights.sum(dim=1)

    def __call__(self, weights: Tensor, coordinates: Tensor, iterations: int) -> Tensor:
        """Weights `(mesh, side)` after so many visits to every group, from the weights given."""
        weights, target = weights.clone(), coordinates @ self.model.deltas.T
        for _ in range(iterations):
            misfit = (
                self.model.features(weights) @ self.gram - target
            )  # computed again each time, so that rounding errors do not accumulate
            for group in self.groups:
                if len(group) == 1:
                    self._visit(group[0], weights, misfit)
                else:
                    self._visit_rivals(group, weights, misfit)
        return weights

    def _visit(self, side: int, weights: Tensor, misfit: Tensor) -> None:
        """Put one weight at its minimum."""
        others = self._others(side, weights)
        derivative, bend = self._derivative(side, others, misfit), self._bend(side, others)
        before = weights[:, side].clone()
        weights[:, side] = self._least(derivative - bend * before, bend)
        change = (weights[:, side] - before)[:, None] * others
        misfit.addmm_(change, self.rows[side])

    def _visit_rivals(self, group: list[int], weights: Tensor, misfit: Tensor) -> None:
        """Put that one of a few weights at its minimum that gains the most, and the others at 0."""
        others = [self._others(side, weights) for side in group]
        for side, other in zip(group, others):
            misfit.addmm_(-weights[:, side, None] * other, self.rows[side])
        values, gains = [], []
        for side, other in zip(group, others):
            derivative, bend = self._derivative(side, other, misfit), self._bend(side, other)
            values.append(self._least(derivative, bend))
            gains.append(-derivative * values[-1] - 0.5 * bend * values[-1] ** 2)
        best = torch.stack(gains).argmax(dim=0)
        for number, (side, other, value) in enumerate(zip(group, others, values)):
            weights[:, side] = torch.where(best == number, value, 0.0)
            misfit.addmm_(weights[:, side, None] * other, self.rows[side])

    def _derivative(self, side: int, others: Tensor, misfit: Tensor) -> Tensor:
        return self.sparsity + (misfit[:, self.model.terms_of_side[side]] * others).sum(dim=1)

    def _bend(self, side: int, others: Tensor) -> Tensor:
        return ((others @ self.blocks[side]) * others).sum(dim=1)

    def _least(self, derivative: Tensor, bend: Tensor) -> Tensor:
        """The minimum in [0, 1] of derivative w + bend w^2 / 2; 0 for a weight that does nothing."""
        return torch.where(bend > self.least, (-derivative / bend.clamp_min(self.least)).clamp(0, 1), 0.0)

    def _others(self, side: int, weights: Tensor) -> Tensor:
        """The terms of a side `(mesh, term)` at weight 1 of it, the others being where they are."""
        padded = torch.cat([weights, weights.new_ones(len(weights), 1)], dim=1)
        padded[:, side] = 1.0
        return padded[:, self.members[side]].prod(dim=2)


class CoordinateDescent(BatchedMethod):
    """Coordinate descent from neutral.

    Args:
        pairs, triples, quadruples: products of two, three and four controls that are kept, the strongest.
        iterations: visits to every control.
        sparsity: penalty on the sum of the weights, mm^2 of mean squared error for a weight of 1.
    """

    batch_size = 256
    source = (
        "Rackovic, Soares, Jakovetic, Desnica: High-fidelity interpretable inverse rig: an accurate and sparse solution "
        "optimizing the quartic blendshape model (arXiv 2302.04820). Changed: Gram form, equal to the published steps and "
        "some hundred times as fast; the products are measured from the rig, for not every rig is a quartic one; of a "
        "two-sided control only one side may be active, the better one; 50 iterations and a faint penalty where the "
        "scripts have 7 and a strong one; it starts at neutral where theirs starts at a clipped pseudo-inverse."
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        pairs: NonNegativeInt = 1000,
        triples: NonNegativeInt = 300,
        quadruples: NonNegativeInt = 50,
        iterations: PositiveInt = 50,
        sparsity: NonNegativeFloat = 1e-4,
    ) -> None:
        super().__init__(rig)
        self.products, self.iterations = [pairs, triples, quadruples], iterations
        self.sparsity = 0.5 * sparsity * rig.space.vertex_count  # of half the squared distance

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        self.descent = GramDescent(with_products(self.rig, ramps(self.rig, squares=False), self.products), self.sparsity)

    def solve(self, coordinates: Tensor) -> Tensor:
        sides = self.descent.model.sides
        start = torch.zeros(len(coordinates), len(sides), dtype=torch.float64)
        return sides.controls(self.descent(start, coordinates.double(), self.iterations))
