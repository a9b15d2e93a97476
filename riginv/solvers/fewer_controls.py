"""The same mesh with fewer active controls.

Different controls often make one mesh: a macro, or the controls that it combines. Steps of Levenberg-Marquardt end at whichever
of them the start had. An L1 penalty on the distance of each control from neutral finds the controls that are needed. It also
shrinks them, so it is reweighted (Candes, Wakin, Boyd 2008: less for controls that are large); last, the controls that it left
at neutral are fixed there, and the others are fitted without a penalty. This is done from near neutral, and where that does not
end in fewer controls, from the solution.
"""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.solvers.levenberg_marquardt import Pace, levenberg_marquardt
from riginv.solvers.objective import Linearised, Objective, Result
from riginv.solvers.starts import start_by_derivative

PENALTY = 1e-4  # mm^2 of half the mean squared distance, for one control at its whole range
NEAR_STEPS = ((PENALTY, 8),)  # penalties and linearisations from a solution
FAR_STEPS = ((10 * PENALTY, 12), (PENALTY, 6))  # the same from near neutral
CORNERS, STEPS = (0.1, 0.03), 4  # fractions of a range at which the penalty halves, of each reweighting; its linearisations
LAST_STEPS = 6  # without penalties
MOST_ERROR, MOST_MM = 1.02, 1e-3  # how far the root mean square distance may rise: by a factor, or by so many mm
PACE = Pace(damping=1e-4, longest_step=0.3)
BATCH_SIZE = 128  # bounds the memory


class OneSidedObjective:
    """An objective of distances from neutral, each to one side, with a penalty for every mesh and control.

    The variables are fractions `(mesh, control)` of the distance from neutral to a limit. Coordinates of meshes are
    followed by the signed extent of each control, the distance from neutral to that limit (0: it is fixed), and by its penalty.
    """

    def __init__(self, objective: Objective) -> None:
        self.objective, self.squared_mm, self.gradient_steps = objective, objective.squared_mm, objective.gradient_steps
        self.neutral = torch.zeros_like(objective.neutral)

    def run_tasks(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """As `Objective.run_tasks`."""
        return self.objective.run_tasks(tasks)

    def cost(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Tensor:
        """The objective `(mesh,)`."""
        coordinates, extent, penalty = self._split(coordinates)
        return self.objective.cost(self.objective.neutral + extent * units, coordinates, weights) + (penalty * units).sum(dim=1)

    def prior_cost(self, units: Tensor) -> Tensor:
        """The part of the objective `(mesh,)` that does not depend on the mesh: none."""
        return torch.zeros_like(units[:, 0])

    def gradient(self, units: Tensor, coordinates: Tensor) -> Tensor:
        """The gradient `(mesh, control)` of the objective."""
        coordinates, extent, penalty = self._split(coordinates)
        return extent * self.objective.gradient(self.objective.neutral + extent * units, coordinates) + penalty

    def linearise(self, units: Tensor, coordinates: Tensor, weights: Tensor | None = None) -> Linearised:
        """The objective with its gradient and Gauss-Newton Hessian."""
        coordinates, extent, penalty = self._split(coordinates)
        cost, gradient, hessian = self.objective.linearise(self.objective.neutral + extent * units, coordinates, weights)
        hessian = hessian * extent[:, :, None] * extent[:, None, :]
        hessian.diagonal(dim1=1, dim2=2).add_(extent == 0)  # so that it stays definite
        return Linearised(cost + (penalty * units).sum(dim=1), extent * gradient + penalty, hessian)

    def _split(self, coordinates: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Coordinates, extents, and penalties of whole extents."""
        count = len(self.neutral)
        coordinates, extent, penalty = coordinates.tensor_split((-2 * count, -count), dim=1)
        return coordinates, extent, penalty * extent.abs()


@torch.no_grad()
def with_fewer_controls(
    objective: Objective, coordinates: Float[Tensor, "mesh coordinate"], found: Float[Tensor, "mesh control"]
) -> Float[Tensor, "mesh control"]:
    """Solutions `(mesh, control)` with fewer active controls, the others at neutral; as fractions of the ranges.

    The root mean square distance of a mesh rises by at most 2 %, or by 0.001 mm where that is more; a mesh for which this needs
    all controls of its solution keeps it.

    Args:
        coordinates: of the meshes; those with NaN keep their solutions.
        found: the solutions to start from, as fractions of the ranges.
    """
    batches = zip(coordinates.to(found).split(BATCH_SIZE), found.split(BATCH_SIZE))
    selected = [_with_fewer(objective, *batch) for batch in batches if len(batch[0])]
    return torch.cat(selected) if selected else found


def _with_fewer(objective: Objective, coordinates: Tensor, found: Tensor) -> Tensor:
    distance, size = _distance_mm(objective, coordinates, found), _log_size(objective, found)
    most = torch.maximum(MOST_ERROR * distance, distance + MOST_MM)
    best, rows = found.clone(), torch.arange(len(found), device=found.device)
    for starts, penalties in ((start_by_derivative(objective, coordinates), FAR_STEPS), (found, NEAR_STEPS)):
        if not len(rows):
            break
        units = _sparse(objective, coordinates[rows], starts[rows], penalties)
        smaller = _log_size(objective, units) < size[rows]
        smaller &= _distance_mm(objective, coordinates[rows], units) <= most[rows]
        best[rows[smaller]] = units[smaller]
        rows = rows[~smaller]
    return best


def _sparse(objective: Objective, coordinates: Tensor, units: Tensor, penalties: tuple[tuple[float, int], ...]) -> Tensor:
    """Reduce the distance from a start with few controls, whatever the distance at the end."""
    equal = torch.full_like(units, objective.squared_mm)
    for penalty, steps in penalties:
        units = _solve(objective, coordinates, units, penalty * equal, steps)
    for corner in CORNERS:
        weights = corner / (corner + (units - objective.neutral).abs())
        units = _solve(objective, coordinates, units, PENALTY * weights * equal, STEPS)
    return _solve(objective, coordinates, units, 0 * equal, LAST_STEPS, units != objective.neutral)


def _log_size(objective: Objective, units: Tensor) -> Tensor:
    """The penalty `(mesh,)` that reweighting minimises: nearly the number of active controls."""
    return torch.log1p((units - objective.neutral).abs() / CORNERS[-1]).sum(dim=1)


def _solve(
    objective: Objective, coordinates: Tensor, units: Tensor, penalty: Tensor, steps: int, free: Tensor | None = None
) -> Tensor:
    """Minimise the objective with a penalty `(mesh, control)`, controls on their sides of neutral or on that of the descent."""
    away, neutral = units - objective.neutral, objective.neutral
    side = torch.where(away == 0, -objective.gradient(units, coordinates), away)
    up = (neutral < 1) & ((side >= 0) | (neutral <= 0))
    extent = torch.where(up, 1 - neutral, -neutral)
    if free is not None:
        extent = torch.where(free, extent, 0.0)
    packed = torch.cat([coordinates, extent, penalty], dim=1)
    start = away / torch.where(extent == 0, 1.0, extent)
    return neutral + extent * levenberg_marquardt(OneSidedObjective(objective), packed, start, steps, pace=PACE).units


def _distance_mm(objective: Objective, coordinates: Tensor, units: Tensor) -> Tensor:
    """The root mean square distance of the vertices, `(mesh,)`."""
    cost = objective.cost(units, coordinates) - objective.prior_cost(units)
    return (2 * cost.clamp_min(0) / objective.squared_mm).sqrt()
