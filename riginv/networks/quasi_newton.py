"""Steps by gradients alone after an inverse network, and in it for rigs whose Jacobian costs a hundred times as much as one.

L-BFGS (Nocedal 1980, "Updating quasi-Newton matrices with limited storage") from the mean Gauss-Newton Hessian over random
poses. A control that is neutral inside its range often drives two shapes, one on either side, so that the derivative jumps
there: the Hessian is kept for either side of each control, and each mesh takes that of its own sides (docs/experiments.md).
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.geometry.kernels.library import Kernels, kernels_for
from riginv.networks.control_maps import ControlMap
from riginv.networks.distance_weights import DistanceWeights
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import sparse_controls

POSES, BATCH_SIZE = 64, 16  # that the Hessian is a mean over; BATCH_SIZE bounds the memory
DAMPING = 1.0  # of the diagonal, relative
STAGE_DAMPING = 0.3  # the same, of a network's stages, which take single steps
DISTANCE_DAMPING = 6.0  # the same, of steps on the mean distance, which start from the diagonal alone
LEAST_DERIVATIVE = 0.1  # of a control by its raw output, as a fraction of its range: close to a limit it vanishes
LEAST, TINY = 1e-9, 1e-12  # lower bounds of the diagonal, relative to its greatest element, and of that and of curvatures
SOLVE_STEPS = 12  # of conjugate gradients: no factorisation, which ONNX does not have
LONGEST_STEP, LONGEST_RAW_STEP = 0.3, 1.0  # as a fraction of a control's range; of a raw output
SHORTER = 0.5  # a step that fails is tried again at this fraction


Evaluate = Callable[[Tensor], tuple[Tensor, Callable[[], Tensor]]]


class _State(NamedTuple):
    """Controls as fractions of their ranges `(mesh, control)`, each mesh's error `(mesh,)`, and its gradient."""

    units: Tensor
    cost: Tensor
    gradient: Tensor


class _Pair(NamedTuple):
    """A step and the change of the gradient by it, `(mesh, control)`, and one over their inner product, `(mesh, 1)`.

    That is 0 where the error is not convex along the step.
    """

    step: Tensor
    change: Tensor
    inverse: Tensor

    @classmethod
    def of(cls, step: Tensor, change: Tensor) -> "_Pair":
        product = (step * change).sum(dim=1, keepdim=True)
        sizes = step.norm(dim=1, keepdim=True) * change.norm(dim=1, keepdim=True)
        return cls(step, change, torch.where(product > LEAST * sizes, 1 / product.clamp_min(TINY), 0.0))


class QuasiNewton(nn.Module):
    """Lowers the error of each mesh from an estimate, within the controls' limits.

    Args:
        rig: in mesh space.
        steps: their number; each takes one gradient through the rig.
        distance: whose mean distance is the error; None: it is half the squared error.
    """

    hessian: Tensor
    lower: Tensor
    span: Tensor
    neutral: Tensor

    def __init__(self, rig: RigInMeshSpace, steps: int, distance: DistanceWeights | None = None) -> None:
        super().__init__()
        self.steps, self.distance, source = steps, distance, rig.source
        span = source.upper - source.lower
        self.register_buffer("lower", source.lower, persistent=False)
        self.register_buffer("span", span, persistent=False)
        self.register_buffer("neutral", (source.neutral_controls - source.lower) / span, persistent=False)
        self.register_buffer("hessian", torch.eye(2 * len(span)).to(rig.linear_map))

    @torch.no_grad()
    def calibrate(self, rig: RigInMeshSpace) -> None:
        """Set the Hessian from random poses of the rig, and the clusters of the distance.

        With J the Jacobian, P its mean over the poses with a control on one side, column by column and for both sides, and R
        the residual J - P: P^T P, to which the mean of R^T R is added for any sides.
        """
        if self.distance:
            self.distance.calibrate(rig.space)
        source = rig.source
        limits = source.lower, source.upper, source.neutral_controls
        controls = sparse_controls(*limits, len(self.span), POSES, generator_at(0, "quasi-Newton", device=source.lower.device))
        jacobians = torch.cat([self._jacobian(rig, batch) for batch in controls.split(BATCH_SIZE)])
        sides = self._sides((controls - self.lower) / self.span)
        counts = sides.sum(dim=0).clamp_min(1)
        means = torch.einsum("pci,psi->csi", jacobians, sides) / counts
        rest = jacobians - torch.einsum("csi,psi->pci", means, sides)
        shared = torch.einsum("pci,pcj->ij", rest, rest) / len(rest)
        columns = means.flatten(1)
        self.hessian.copy_(columns.T @ columns + shared.repeat(2, 2))

    def forward(
        self,
        rig: RigInMeshSpace,
        controls: Float[Tensor, "mesh control"],
        coordinates: Float[Tensor, "mesh coordinate"],
        steps: int | None = None,
    ) -> Float[Tensor, "mesh control"]:
        """The controls `(mesh, control)` after the steps, without a graph; no mesh's error is greater than at the start.

        Args:
            controls: the estimate.
            coordinates: of the target meshes.
            steps: their number, if not as always.
        """
        steps = self.steps if steps is None else steps
        return self.minimise(partial(self._evaluate, rig, coordinates), controls.detach(), steps)

    @torch.no_grad()
    def minimise(
        self, evaluate: Evaluate, controls: Float[Tensor, "mesh control"], steps: int
    ) -> Float[Tensor, "mesh control"]:
        """As `forward`, of an error that is given.

        Args:
            evaluate: from controls as fractions of their ranges to each mesh's error, and a function that returns its gradient
                by these, or a multiple of that.
            steps: their number.
        """
        units = ((controls - self.lower) / self.span).clamp(0, 1)
        if not steps:
            return self.lower + self.span * units
        if self.distance and (compiled := kernels_for(units, self.neutral)) is not None:
            return self.lower + self.span * self._minimise_compiled(compiled, evaluate, units, steps)
        cost, gradient = evaluate(units)
        length = torch.ones_like(cost)
        pairs: list[_Pair] = []
        best = _State(units, cost, gradient())
        for number in range(1, steps + 1):
            step = (-length[:, None] * self._direction(best, pairs)).clamp(-LONGEST_STEP, LONGEST_STEP)
            units = (best.units + step).clamp(0, 1)
            cost, gradient = evaluate(units)
            better = cost < best.cost
            if number == steps:  # the last gradient is not needed
                best = best._replace(units=torch.where(better[:, None], units, best.units))
                break
            new = _State(units, cost, gradient())
            pairs.append(_Pair.of(units - best.units, new.gradient - best.gradient))
            length = torch.where(better, 1.0, SHORTER * length)
            best = _State(*(torch.where(better.view(-1, *[1] * (b.dim() - 1)), b, a) for a, b in zip(best, new)))
        return self.lower + self.span * best.units

    def _minimise_compiled(self, compiled: Kernels, evaluate: Evaluate, units: Tensor, steps: int) -> Tensor:
        """The units of `minimise` on the mean distance, with a kernel between evaluations."""
        (batch, controls), dtype, most = units.shape, units.dtype, max(steps - 1, 1)

        def evaluated(units: Tensor) -> tuple[Tensor, Callable[[], Tensor]]:
            cost, gradient = evaluate(units)
            return cost.to(dtype).contiguous(), lambda: gradient().to(dtype).contiguous()

        cost, gradient = evaluated(units)
        best = units.contiguous(), cost.clone(), gradient()
        length, inverses = torch.ones_like(cost), units.new_empty(batch, most)
        pairs = units.new_empty(batch, most, controls), units.new_empty(batch, most, controls)
        neutral, diagonals = self.neutral.contiguous(), (self._diagonals * (1 + DISTANCE_DAMPING)).to(dtype)
        limits = units.new_tensor([LONGEST_STEP, SHORTER, LEAST, TINY])
        for number in range(steps):
            found = torch.empty_like(best[0])
            state = best[0], best[2], length, *pairs, inverses, number, most
            compiled.call("quasi_newton_step", dtype, *state, neutral, diagonals, limits, found, controls, batch)
            cost, gradient = evaluated(found)
            following = gradient() if number + 1 < steps else None  # the last gradient is not needed
            kept = *best, length, *pairs, inverses, number, most
            compiled.call("quasi_newton_keep", dtype, found, cost, following, *kept, limits, controls, batch)
        return best[0]

    def stage_step(
        self, control_map: ControlMap, raw: Float[Tensor, "mesh control"], gradient: Float[Tensor, "mesh control"]
    ) -> Float[Tensor, "mesh control"]:
        """A single step of a network's raw outputs `(mesh, control)`, from the gradient of half the squared error by these."""
        controls, to_raw = control_map.with_vjp(raw)
        derivatives = (to_raw(torch.ones_like(raw)) / self.span).clamp_min(LEAST_DERIVATIVE)
        sides = self._sides((controls - self.lower) / self.span) * derivatives[:, None]
        return -self._solve(sides, gradient, STAGE_DAMPING).clamp(-LONGEST_RAW_STEP, LONGEST_RAW_STEP)

    def _evaluate(self, rig: RigInMeshSpace, coordinates: Tensor, units: Tensor) -> tuple[Tensor, Callable[[], Tensor]]:
        found, vjp = rig.coordinates_and_vjp(self.lower + self.span * units)
        error = found - coordinates
        if self.distance is None:
            return 0.5 * error.square().sum(dim=1), lambda: self.span * vjp(error)
        weighted = self.distance(error)
        return weighted.distance, lambda: self.span * vjp(weighted.error)

    def _direction(self, state: _State, pairs: list[_Pair]) -> Tensor:
        """The inverse of the updated Hessian times the gradient, by Nocedal's two loops over all pairs of steps so far."""
        vector, factors = state.gradient, []
        for pair in reversed(pairs):
            factors.append(pair.inverse * (pair.step * vector).sum(dim=1, keepdim=True))
            vector = vector - factors[-1] * pair.change
        sides = self._sides(state.units)
        if self.distance:
            vector = vector / ((sides * self._diagonals).sum(dim=1) * (1 + DISTANCE_DAMPING))
        else:
            vector = self._solve(sides, vector)
        for pair, factor in zip(pairs, reversed(factors)):
            vector = vector + (factor - pair.inverse * (pair.change * vector).sum(dim=1, keepdim=True)) * pair.step
        return vector

    def _sides(self, units: Tensor) -> Float[Tensor, "mesh 2 control"]:
        """Which side of neutral each control is on; one with a single side counts as above."""
        below = (units < self.neutral) & (self.neutral < 1)
        return torch.stack([~below, below], dim=1).to(units)

    @property
    def _diagonals(self) -> Float[Tensor, "2 control"]:
        """Of the Hessian, for either side."""
        diagonals = self.hessian.diagonal()
        return torch.maximum(diagonals, LEAST * diagonals.max() + TINY).view(2, -1)

    def _solve(self, sides: Tensor, gradient: Tensor, damping: float = DAMPING) -> Tensor:
        """The inverse of each mesh's damped Hessian times a vector `(mesh, control)`, by conjugate gradients.

        Sides may be multiplied by derivatives of the controls; damping is proportional to these, and not to their squares, so
        that controls close to a limit move less.
        """
        diagonal = (sides * self._diagonals).sum(dim=1)
        root = (diagonal * (1 + damping)).sqrt()

        def product(vector: Tensor) -> Tensor:
            vector = vector / root
            both = (sides * vector[:, None]).flatten(1) @ self.hessian
            return ((sides * both.view_as(sides)).sum(dim=1) + damping * diagonal * vector) / root

        residual = gradient / root
        result, direction = torch.zeros_like(residual), residual
        square = residual.square().sum(dim=1, keepdim=True)
        for _ in range(SOLVE_STEPS):
            image = product(direction)
            rate = square / (direction * image).sum(dim=1, keepdim=True).clamp_min(TINY)
            result, residual = result + rate * direction, residual - rate * image
            before, square = square, residual.square().sum(dim=1, keepdim=True)
            direction = residual + square / before.clamp_min(TINY) * direction
        return result / root

    def _jacobian(self, rig: RigInMeshSpace, controls: Tensor) -> Float[Tensor, "pose coordinate control"]:
        """The Jacobians of mesh coordinates by controls as fractions of their ranges."""
        return rig.linear_map.T @ rig.source.coefficient_jacobian(controls)[1].dense() * self.span
