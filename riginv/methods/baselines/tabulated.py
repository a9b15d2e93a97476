"""Gustafson et al.: Gauss-Newton with the analytic Jacobian of an approximation that is made to be evaluated fast."""

import torch
from torch import Tensor

from riginv.config.values import AtLeast2, NonNegativeFloat, NonNegativeInt, PositiveInt
from riginv.methods.base import BatchedMethod
from riginv.methods.baselines.measured import tables, with_products
from riginv.methods.baselines.model_objective import ModelObjective
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.box_step import box_step, damping_diagonal
from riginv.solvers.objective import PRIOR

DAMPING = 1e-3  # of the diagonal: Gauss-Newton all the same, but a rank-deficient rig still has a step
HALVINGS = 4  # of a step that does not help


class TabulatedGaussNewton(BatchedMethod):
    """A fixed number of Gauss-Newton steps on a rig compiled to tables.

    Each control's path is a table of its poses, each pair of controls that do something together a product of two tabulated
    curves: the Jacobian is a table look-up and a product, and neither curves nor limits of the rig are evaluated again.

    Args:
        knots: pieces of each table.
        pairs, triples: products of two and of three controls that are kept, the strongest.
        steps: of Gauss-Newton, for every mesh from neutral.
        prior: pull to neutral, mm^2 of mean squared error for one control by its whole range.
    """

    source = (
        "Gustafson, Lo, Kanyuk: Analytically learning an inverse rig mapping (SIGGRAPH Talks 2020): an approximation of "
        "the rig is derived offline, and inverted by an iterative least-squares solver with its analytic Jacobian. A talk "
        "of two pages: the form of the approximation is our choice (tabulated paths and products of tabulated curves, in "
        "mesh coordinates), for theirs is made for joints and ours must serve any rig. Changed besides: a weight for each "
        "way out of neutral, limits by an active set, a faint prior, and steps that do not help are halved; every frame "
        "starts at neutral, so that frames can be solved together."
    )

    def __init__(
        self,
        rig: RigInMeshSpace,
        knots: AtLeast2 = 8,
        pairs: NonNegativeInt = 1000,
        triples: NonNegativeInt = 200,
        steps: PositiveInt = 12,
        prior: NonNegativeFloat = PRIOR,
    ) -> None:
        super().__init__(rig)
        self.knots, self.products, self.steps = knots, [pairs, triples], steps
        self.prior = prior

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        model = with_products(self.rig, tables(self.rig, self.knots), self.products)
        self.objective = ModelObjective(model, self.rig.space.vertex_count, self.prior)

    @torch.no_grad()
    def solve(self, coordinates: Tensor) -> Tensor:
        coordinates = coordinates.double()
        at = self.objective.neutral.expand(len(coordinates), -1).clone()
        for _ in range(self.steps):
            near = self.objective.linearise(at, coordinates)
            step = box_step(
                near.hessian, near.gradient, at, damping_diagonal(near.hessian, torch.full_like(near.cost, DAMPING))
            )
            waiting = torch.ones_like(near.cost, dtype=torch.bool)
            for _ in range(HALVINGS):
                better = waiting & (self.objective.cost(at + step, coordinates) < near.cost)
                at = torch.where(better[:, None], at + step, at)
                waiting &= ~better
                if not bool(waiting.any()):
                    break
                step = step / 2
        return self.objective.model.sides.controls(at.clamp(0, 1))
