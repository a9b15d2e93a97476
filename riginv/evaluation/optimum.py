"""The optimum: the least vertex error that many-start Levenberg-Marquardt finds, on a few meshes of a set."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from riginv.evaluation.results import EvaluationResult
from riginv.geometry.distances import mean_distance
from riginv.geometry.neighbours import evenly
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.random_controls import sparse_controls
from riginv.runs.cache import cached_tensors, code_key
from riginv.solvers.every_mesh import descend_mean_distance, refine_meshes, solve_meshes
from riginv.solvers.objective import Objective

MESHES = 40  # of each set, evenly spread
MIN_OPTIMUM_MM = 1e-3  # lower bound of the optimum in ratios, against division by about 0
SEED = 20221206


class Budget(NamedTuple):
    """The effort of a solver on each mesh, as in `solve_meshes`."""

    starts: int
    steps: int
    tolerance: float = 1e-5
    descent_steps: int = 0


FULL, BOUND = Budget(6, 60, descent_steps=300), Budget(2, 5, descent_steps=10)


@dataclass(frozen=True)
class Optimum:
    """The least mean vertex distances that solvers found on some meshes of a set.

    Attributes:
        rows: which meshes `(mesh,)`.
        errors_mm: the mean vertex error of each on the true rig, `(mesh,)`.
        is_bound: whether it is only an upper bound, from few steps in a basis fitted to the true rig.
    """

    rows: Tensor
    errors_mm: Tensor
    is_bound: bool = False

    @property
    def mean_mm(self) -> float:
        return float(self.errors_mm.double().mean())

    def ratio(self, result: EvaluationResult) -> float:
        """The ratio of a result's mean error to the optimum, on the same meshes."""
        return float(result.errors_mm[self.rows].double().mean()) / max(self.mean_mm, MIN_OPTIMUM_MM)

    def metrics(self, result: EvaluationResult) -> dict[str, float]:
        """The optimum and the ratio to it, by `SET/key`."""
        name = result.meshes.name
        values = {"optimum_mean_vertex_error_mm": self.mean_mm, "optimum_ratio": self.ratio(result)}
        values |= {"optimum_is_bound": 1.0} if self.is_bound else {}  # metrics are numbers
        return {f"{name}/{key}": value for key, value in values.items()}


def basis_for(true_rig: RigBackend, fitted: LinearRig | None) -> LinearRig | None:
    """The rig in which the optimum of a true rig is sought: itself, or a basis fitted to it; None: gradients pass neither."""
    rig = true_rig if isinstance(true_rig, LinearRig) or fitted is None or not fitted.is_fitted else fitted
    return rig if isinstance(rig, LinearRig) and rig.differentiable else None


def find_optima(true_rig: RigBackend, sets: list[MeshSet], fitted: LinearRig | None = None) -> dict[str, Optimum]:
    """The optimum of each set, by name, cached; empty for rigs that are not differentiable.

    The squared error is minimised from many starts, then the mean vertex distance by gradient descent from there.

    Args:
        fitted: a basis fitted to the true rig, for one that does not end in a linear map: few starts and steps in that basis
            give an upper bound of the optimum; its errors are those of the true rig's meshes.
    """
    rig = basis_for(true_rig, fitted)
    if rig is None:
        return {}
    is_bound = rig is not true_rig
    key, objective, optima = rig_digest(rig), None, {}
    for meshes in sets:
        if not len(meshes):
            continue
        rows = evenly(MESHES, len(meshes))
        vertices = torch.cat([meshes.vertices(row, row + 1) for row in rows.tolist()])

        known = known_vertices(meshes, rows)

        def solve(vertices: Tensor = vertices, known: Tensor | None = known) -> dict[str, Tensor]:
            nonlocal objective
            objective = objective or Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)))
            return {"errors_mm": least_errors(objective, true_rig, vertices, known, BOUND if is_bound else FULL)}

        facts = vertices.cpu().numpy().tobytes() + (b"" if known is None else known.cpu().numpy().tobytes())
        name = hashlib.sha256(key + facts).hexdigest()[:32]
        optima[meshes.name] = Optimum(rows, cached_tensors("optimum", name, solve)["errors_mm"], is_bound)
    return optima


@torch.no_grad()
def least_errors(
    objective: Objective,
    true_rig: RigBackend,
    vertices: Float[Tensor, "mesh vertex 3"],
    known: Bool[Tensor, "mesh vertex"] | None = None,
    budget: Budget = FULL,
    start: Float[Tensor, "mesh control"] | None = None,
) -> Float[Tensor, " mesh"]:
    """The least mean vertex errors `(mesh,)`, mm, that were found for meshes `(mesh, vertex, 3)`.

    Args:
        objective: of a basis of the true rig (`basis_for`).
        true_rig: whose meshes are compared.
        known: the vertices that errors are measured at, `(mesh, vertex)`; None: all.
        start: controls `(mesh, control)` to start from as well; None: there are none.
    """
    coordinates = objective.rig.space.encode(vertices)
    squares = solve_meshes(objective, coordinates, *budget)
    if start is not None:
        refined = refine_meshes(objective, coordinates, objective.units(start), budget.steps)
        squares.take_better(torch.arange(len(vertices)), refined)
    masks = [None] * len(vertices) if known is None else known[:, None]
    errors = []
    for units in (squares.units, descend_mean_distance(objective, coordinates, squares.units)):
        pairs = zip(objective.to_controls(units), vertices, masks)
        errors.append(torch.cat([mean_distance(true_rig(controls[None]), mesh[None], mask) for controls, mesh, mask in pairs]))
    return torch.minimum(*errors)


def known_vertices(meshes: MeshSet, rows: Tensor) -> Tensor | None:
    """The vertices at which errors of some meshes of a set are measured, a mask `(mesh, vertex)`; None: all."""
    masks = [mask for row in rows.tolist() if (mask := meshes.known(row, row + 1)) is not None]
    return torch.cat(masks) if masks else None


@torch.no_grad()
def rig_digest(rig: LinearRig) -> bytes:
    """A hash of what determines a rig: its basis, its limits, and its coefficients in some poses."""
    limits = rig.lower, rig.upper, rig.neutral_controls
    poses = sparse_controls(*limits, len(rig.controls), 16, generator_at(SEED, "fingerprint")).to(rig.device)
    facts = (rig.basis, rig.coefficients(poses), *limits, torch.tensor([*FULL, *BOUND]))
    here, package = Path(__file__), Path(__file__).parents[1]
    digest = hashlib.sha256(code_key([here, package / "solvers", package / "networks/features.py"]).encode())
    for fact in facts:
        digest.update(fact.detach().cpu().contiguous().numpy().tobytes())
    return digest.digest()
