"""Rackovic et al.: a second-order approximation of the rig, inverted by Levenberg-Marquardt."""

from typing import Any

import torch
from torch import Tensor

from riginv.config.values import NonNegativeFloat, NonNegativeInt, PositiveInt
from riginv.methods.base import BatchedMethod
from riginv.methods.baselines.measured import ramps, with_products
from riginv.methods.baselines.model_objective import ModelObjective
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.levenberg_marquardt import levenberg_marquardt
from riginv.solvers.objective import PRIOR


class QuadraticLevenbergMarquardt(BatchedMethod):
    """Levenberg-Marquardt on a polynomial of second order in the controls, from neutral.

    Args:
        pairs: products of two controls that are kept, the strongest.
        steps: of Levenberg-Marquardt, at most.
        sparsity: penalty on the sum of the weights, mm^2 of mean squared error for a weight of 1.
    """

    source = (
        "Rackovic, Soares, Jakovetic, Desnica: Accurate, interpretable, and fast animation: an iterative, sparse, and "
        "nonconvex approach (arXiv 2109.08356): a second-order polynomial of the rig, Levenberg-Marquardt, a penalty on "
        "the sum of the weights. Changed: the coefficients are measured from the rig (each control alone at half and "
        "full, each pair at full) where theirs came with the rig; a square for each control, since a single control of "
        "ours bends its path; each step is solved exactly within the limits, which is cheap in mesh coordinates, where "
        "theirs is majorised (that is `majorisation`); each way out of neutral has a weight of its own."
    )

    def __init__(
        self, rig: RigInMeshSpace, pairs: NonNegativeInt = 1000, steps: PositiveInt = 30, sparsity: NonNegativeFloat = 1e-4
    ) -> None:
        super().__init__(rig)
        self.pairs, self.steps = pairs, steps
        self.sparsity = 0.5 * sparsity  # of half the squared distance

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        model = with_products(self.rig, ramps(self.rig, squares=True), [self.pairs])
        self.objective = ModelObjective(model, self.rig.space.vertex_count, PRIOR, self.sparsity)

    @torch.no_grad()
    def solve(self, coordinates: Tensor) -> Tensor:
        objective: Any = self.objective  # it has what the solver uses of an Objective
        start = self.objective.neutral.expand(len(coordinates), -1)
        found = levenberg_marquardt(objective, coordinates.double(), start, self.steps)
        return self.objective.model.sides.controls(found.units)
