"""The optimum: the least vertex error that many-start Levenberg-Marquardt finds, on a few meshes of a set."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import torch
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
STARTS, STEPS, TOLERANCE = 6, 60, 1e-5
DESCENT_STEPS = 300
MIN_OPTIMUM_MM = 1e-3  # lower bound of the optimum in ratios, against division by about 0
BOUND_STARTS, BOUND_STEPS = 2, 10
SEED = 20221206


@dataclass(frozen=True)
class Optimum:
    """The least mean vertex distances that solvers found on some meshes of a set.

    Attributes:
        rows: which meshes `(mesh,)`.
        errors_mm: the mean vertex error of each on the true rig, `(mesh,)`.
        is_bound: whether it is only an upper bound, from few steps of one start (`bound_of_optimum`).
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


def find_optima(true_rig: RigBackend, sets: list[MeshSet], fitted: LinearRig | None = None) -> dict[str, Optimum]:
    """The optimum of each set, by name, cached; empty for rigs that are not differentiable.

    The squared error is minimised from many starts, then the mean vertex distance by gradient descent from there.

    Args:
        fitted: a basis fitted to the true rig, for one that does not end in a linear map: few starts and steps in that basis
            give an upper bound of the optimum; its errors are those of the true rig's meshes.
    """
    is_bound = not isinstance(true_rig, LinearRig) and fitted is not None and fitted.is_fitted
    rig = fitted if is_bound else true_rig
    if not (isinstance(rig, LinearRig) and rig.differentiable):
        return {}
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
            return {"errors_mm": least_errors(objective, true_rig, vertices, known, is_bound)}

        facts = vertices.cpu().numpy().tobytes() + (b"" if known is None else known.cpu().numpy().tobytes())
        name = hashlib.sha256(key + facts).hexdigest()[:32]
        optima[meshes.name] = Optimum(rows, cached_tensors("optimum", name, solve)["errors_mm"], is_bound)
    return optima


@torch.no_grad()
def bound_of_optimum(objective: Objective, result: EvaluationResult) -> Optimum:
    """An upper bound of the optimum for a rig with a fitted basis: Levenberg-Marquardt from predicted controls.

    The steps are taken in the fitted basis, errors are those of the true rig's meshes; a mesh whose error rises keeps
    that of the prediction.

    Args:
        objective: in the mesh space of the inverse.
        result: the evaluation of the predicted controls.
    """
    rows = evenly(MESHES, len(result.meshes))
    vertices = torch.cat([result.meshes.vertices(row, row + 1) for row in rows.tolist()])
    start, known = objective.units(result.controls[rows]), known_vertices(result.meshes, rows)
    units = refine_meshes(objective, objective.rig.space.encode(vertices), start, BOUND_STEPS).units
    errors = mean_distance(result.rig(objective.to_controls(units)), vertices, known)
    return Optimum(rows, torch.minimum(errors.nan_to_num(torch.inf), result.errors_mm[rows]), is_bound=True)


@torch.no_grad()
def least_errors(
    objective: Objective, true_rig: RigBackend, vertices: Tensor, known: Tensor | None = None, is_bound: bool = False
) -> Tensor:
    """The least mean vertex errors `(mesh,)`, mm, that were found for meshes `(mesh, vertex, 3)`.

    Args:
        true_rig: whose meshes are compared.
        is_bound: whether few starts and steps suffice.
        known: the vertices that errors are measured at, `(mesh, vertex)`; None: all.
    """
    coordinates = objective.rig.space.encode(vertices)
    budget = (BOUND_STARTS, BOUND_STEPS, TOLERANCE, BOUND_STEPS) if is_bound else (STARTS, STEPS, TOLERANCE, DESCENT_STEPS)
    squares = solve_meshes(objective, coordinates, *budget).units
    masks = [None] * len(vertices) if known is None else known[:, None]
    errors = []
    for units in (squares, descend_mean_distance(objective, coordinates, squares)):
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
    facts = (rig.basis, rig.coefficients(poses), *limits, torch.tensor([STARTS, STEPS, TOLERANCE, DESCENT_STEPS]))
    here, package = Path(__file__), Path(__file__).parents[1]
    digest = hashlib.sha256(code_key([here, package / "solvers", package / "networks/features.py"]).encode())
    for fact in facts:
        digest.update(fact.detach().cpu().contiguous().numpy().tobytes())
    return digest.digest()
