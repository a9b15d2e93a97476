"""Rounds of drivers, shapes and controls: drivers are chosen by the residual, then shapes and controls are fitted together."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.distances import mean_distance
from riginv.geometry.kernels.library import pure_torch
from riginv.rig.interface import LinearRig
from riginv.rig.jacobian import Jacobian
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.tables import WITHIN_REACH_MM
from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.objective import Objective
from riginv.tracking.missing.drivers import Driver, Factors, numbered
from riginv.tracking.missing.joint_fit import JointFit, Span
from riginv.tracking.missing.known import find_known
from riginv.tracking.missing.search import MIN_GAINS, Limits, choose_drivers, sparse, voters

JOINT_STEPS, STEPS = 10, 6  # of the joint fit of each round; Levenberg-Marquardt steps after it
SPARSITY = 2e-5  # mm^2 of mean squared error for a control at its whole range: of two explanations that with fewer controls
FIRST_SPARSITY = 1e-3  # the same before shapes are known: idle controls would take up much of what is missing


class RigWithShapes(LinearRig):
    """A rig with further shapes, which products of its controls drive.

    Args:
        shapes: `(driver, vertex, 3)`, mm.
    """

    def __init__(self, rig: LinearRig, factors: Factors, drivers: list[Driver], shapes: Tensor) -> None:
        drivers = numbered(drivers)
        names = [*rig.coefficient_names, *(driver.name for driver in drivers)]
        basis = torch.cat([rig.basis, shapes.to(rig.basis)])
        super().__init__(rig.name, rig.controls, rig.rest_vertices, rig.faces, basis, names)
        self.source, self.factors, self.drivers = rig, factors, drivers

    def coefficients(self, controls: Tensor) -> Tensor:
        return torch.cat([self.source.coefficients(controls), self.weights(controls)], dim=1)

    def weights(self, controls: Tensor) -> Tensor:
        """The weights `(frame, driver)` of the further shapes."""
        return self.factors.products(self.factors.values(controls), self.drivers)

    def coefficient_jacobian(self, controls: Tensor) -> tuple[Tensor, Jacobian]:
        found, jacobian = self.source.coefficient_jacobian(controls)
        with torch.enable_grad(), pure_torch():
            given = controls.detach().requires_grad_()
            weights = self.weights(given)
            rows = torch.eye(weights.shape[1]).to(weights)[:, None].expand(-1, len(controls), -1)
            more = torch.autograd.grad(weights, given, rows, is_grads_batched=True)[0].transpose(0, 1)
        inner = torch.cat([jacobian.dense(), more], dim=1)
        return torch.cat([found, weights.detach()], dim=1), Jacobian(inner=inner)


@dataclass(frozen=True)
class Missing:
    """Shapes that a rig lacks for a clip, most important first.

    Attributes:
        rig: the rig with these shapes.
        controls: of the clip with them, `(frame, control)`.
        shapes: `(shape, vertex, 3)`, mm, sparse.
        weights: of the shapes, `(frame, shape)`.
        with_first_mm: mean error, mm, with the first shapes alone: one, two, and so on.
        before_mm, after_mm: mean error of each frame without and with the shapes, `(frame,)`.
    """

    rig: RigWithShapes
    controls: Tensor
    shapes: Tensor
    weights: Tensor
    with_first_mm: list[float]
    before_mm: Tensor
    after_mm: Tensor


@torch.no_grad()
def find_missing(
    rig: LinearRig,
    meshes: Float[Tensor, "frame vertex 3"],
    controls: Float[Tensor, "frame control"],
    most: int,
    most_factors: int,
    known: bool = False,
) -> Missing | None:
    """The shapes, at most `most`, that a rig lacks for meshes, mm; None: it lacks none, or none explains the residual.

    Args:
        controls: a first inversion, or the true ones.
        known: whether they are the true ones: they are not solved again.
        most_factors: of a product of controls.
    """
    factors, before = Factors(rig, known), mean_distance(rig(controls), meshes)
    if float(before.mean()) < WITHIN_REACH_MM:
        return None
    if known:
        augmented = with_known(rig, factors, meshes, controls, most, most_factors)
    else:
        augmented, controls = with_solved(rig, factors, meshes, controls, most, most_factors)
    if augmented is None:
        return None
    weights, shapes = augmented.weights(controls), augmented.basis[len(rig.basis) :]
    lost = weights.square().sum(dim=0) * shapes.square().sum(dim=(1, 2))
    order = lost.argsort(descending=True)
    order = order[lost[order] > 0]
    final = RigWithShapes(rig, factors, [augmented.drivers[number] for number in order.tolist()], shapes[order])
    posed, with_first = rig(controls), []
    for number in order.tolist():
        posed += weights[:, number, None, None] * shapes[number]
        with_first.append(float(mean_distance(posed, meshes).mean()))
    after = mean_distance(posed, meshes)
    return Missing(final, controls, shapes[order], weights[:, order], with_first, before, after)


def with_known(
    rig: LinearRig, factors: Factors, meshes: Tensor, controls: Tensor, most: int, most_factors: int
) -> RigWithShapes | None:
    """The rig with the shapes that it lacks for meshes of known controls; None: it lacks none."""
    values = factors.values(controls)
    drivers = factors.candidates(values, most_factors)
    if not drivers:
        return None
    found, shapes = find_known(factors, drivers, factors.products(values, drivers), meshes - rig(controls), most)
    return RigWithShapes(rig, factors, found, shapes) if found else None


def with_solved(
    rig: LinearRig, factors: Factors, meshes: Tensor, controls: Tensor, most: int, most_factors: int
) -> tuple[RigWithShapes | None, Tensor]:
    """The rig with the shapes that it lacks for meshes, and their controls, from a first inversion; None: it lacks none."""
    augmented, controls = None, solve_again(rig, meshes, controls, FIRST_SPARSITY)
    span = Span.of(rig, meshes, controls)
    for least in MIN_GAINS:
        residual, values = meshes - rig(controls), factors.values(controls)
        drivers = factors.candidates(values, most_factors)
        signals = factors.products(values, drivers) if drivers else values[:, :0]
        voting = voters(residual)
        likelihoods, target = factors.likelihoods(drivers, voting), residual[:, voting]
        chosen = choose_drivers(signals, likelihoods, target, most, Limits(least * float(target.square().sum())))
        if not chosen:
            break
        augmented, controls = with_joint_fit(rig, factors, [drivers[number] for number in chosen], meshes, controls, span)
    return augmented, controls


def with_joint_fit(
    rig: LinearRig, factors: Factors, drivers: list[Driver], meshes: Tensor, controls: Tensor, span: Span
) -> tuple[RigWithShapes, Tensor]:
    """The rig with sparse shapes of drivers, and the controls of meshes, both fitted together."""
    blank = RigWithShapes(rig, factors, drivers, rig.basis.new_zeros(len(drivers), *rig.rest_vertices.shape))
    rows = span.spread_frames(len(rig.controls))
    fit = JointFit(blank, len(drivers), replace(span, target=span.target[rows]), len(rig.rest_vertices))
    controls = controls.clone()
    controls[rows], shapes = fit(controls[rows], JOINT_STEPS)
    augmented = RigWithShapes(rig, factors, drivers, sparse(shapes))
    return augmented, solve_again(augmented, meshes, controls)


def solve_again(rig: LinearRig, meshes: Tensor, controls: Tensor, sparsity: float = SPARSITY) -> Tensor:
    """The controls of meshes, solved with few steps from those that are known."""
    objective = Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), sparsity=sparsity)
    coordinates = torch.cat([objective.rig.space.encode(some) for some in meshes.split(128)])
    return objective.to_controls(refine_meshes(objective, coordinates, objective.units(controls), STEPS).units)
