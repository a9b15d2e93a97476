"""Rackovic et al.: a second-order approximation of the rig, inverted by Levenberg-Marquardt."""

import torch
from torch import Tensor

from riginv.baselines.measured import ramps, with_products
from riginv.baselines.model_objective import ModelObjective
from riginv.baselines.pieces import in_pieces
from riginv.data.mesh_sets import MeshSet
from riginv.mesh_space import RigInMeshSpace
from riginv.methods.base import Method
from riginv.solvers.levenberg_marquardt import levenberg_marquardt
from riginv.solvers.objective import PRIOR

PIECE = 64  # meshes at a time


class QuadraticLevenbergMarquardt(Method):
    """Levenberg-Marquardt on a polynomial of second order in the controls, from neutral.

    Args:
        pairs: products of two controls that are kept, the strongest.
        steps: of Levenberg-Marquardt, at most.
        prior: pull to neutral, mm^2 of mean squared error for one control by its whole range.
    """

    source = (
        "Rackovic, Soares, Jakovetic, Desnica: An iterative approach to the inverse rig with quadratic corrective terms "
        "(2021, arXiv 2109.08356), as the paper cites it: second-order polynomial and Levenberg-Marquardt. Changed: the "
        "coefficients are measured from the rig (each control alone at half and full, each pair at full) where theirs "
        "came with the rig; a square for each control, since a single control of ours bends its path; limits by an active "
        "set in each step; each way out of neutral has a weight of its own; residuals in mesh coordinates, which is "
        "exact."
    )

    def __init__(self, rig: RigInMeshSpace, pairs: int = 1000, steps: int = 30, prior: float = PRIOR) -> None:
        super().__init__(rig)
        self.pairs, self.steps, self.prior = pairs, steps, prior * rig.space.vertex_count

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        self.objective = ModelObjective(with_products(self.rig, ramps(self.rig, squares=True), [self.pairs]), self.prior)

    def invert(self, meshes: MeshSet) -> Tensor:
        coordinates = self.coordinates(meshes)
        return in_pieces(coordinates, PIECE, self._solve, len(self.rig.rig.controls))

    @torch.no_grad()
    def _solve(self, coordinates: Tensor) -> Tensor:
        start = self.objective.neutral.expand(len(coordinates), -1)
        found = levenberg_marquardt(self.objective, coordinates.double(), start, self.steps)
        return self.objective.model.sides.controls(found.units)
