"""Joint fit of shapes and controls: Gauss-Newton steps on both, in the space that the rig and the residual of the clip span.

Controls that were solved without a shape have taken up a part of it. Alternation gives that back slowly; here the shapes are
fitted to what no change of the free controls of a frame can make (variable projection), and both change in one step.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig
from riginv.rig.jacobian import Jacobian
from riginv.tracking.missing.search import conjugate_gradients

SPARSITY = 1e-5  # mm^2 of half the mean squared error for a control at its whole range
DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e3
LESS, MORE = 1 / 6, 8.0  # damping after a step that succeeds, and after one that fails
RIDGE = 1e-6  # of a driver of unit length
FLOOR = 1e-7  # mm^2, of a control in the Hessian
INNER_STEPS = 60  # of conjugate gradients
NEGLIGIBLE_MM, DIRECTIONS = 1e-3, 200  # of the residual: least root mean square distance of a direction, and their number
MAX_NUMBERS = 40_000_000  # of the derivatives of all frames: 320 MB; of longer clips evenly spread frames are used
GAINS_LITTLE = 1e-4  # of the cost: the last step


@dataclass(frozen=True)
class Span:
    """Meshes as coordinates in the span of a rig's basis and of the residual of a clip.

    Attributes:
        directions: orthonormal, `(coordinate, number)`.
        basis: of the rig, `(coefficient, coordinate)`.
        target: the clip, `(frame, coordinate)`, relative to the neutral coefficients' mesh.
    """

    directions: Tensor
    basis: Tensor
    target: Tensor

    @classmethod
    def of(cls, rig: LinearRig, meshes: Float[Tensor, "frame vertex 3"], controls: Tensor) -> "Span":
        basis = rig.basis.flatten(1).double()
        rows = torch.linalg.qr(basis.T)[0].T
        residual = (meshes - rig(controls)).flatten(1).double()
        rest = residual - (residual @ rows.T) @ rows
        squares, vectors = torch.linalg.eigh(rest @ rest.T)
        kept = (squares > NEGLIGIBLE_MM**2 * rest.numel() / 3).nonzero()[-DIRECTIONS:, 0]
        directions = torch.linalg.qr(torch.cat([rows, vectors[:, kept].T @ rest]).T)[0].T
        start = rig.rest_vertices.flatten() - (rig.neutral_coefficients() @ rig.basis.flatten(1))[0]
        target = (meshes.flatten(1) - start).double() @ directions.T
        return cls(directions, basis @ directions.T, target)

    def spread_frames(self, controls: int) -> Tensor:
        """The frames that a joint fit of so many controls has memory for."""
        return evenly(max(1, MAX_NUMBERS // (controls * len(self.directions))), len(self.target))


class JointFit:
    """Fits the shapes of drivers and the controls of a clip to its meshes.

    Args:
        rig: a rig with these drivers (`RigWithShapes`); its own shapes for them are not used.
        count: of the drivers; their weights are the last coefficients.
        vertices: of a mesh.
    """

    def __init__(self, rig: LinearRig, count: int, span: Span, vertices: int) -> None:
        self.rig, self.count, self.span, self.vertices = rig, count, span, vertices
        self.lower, self.range = rig.lower.double(), (rig.upper - rig.lower).double()
        self.neutral = (rig.neutral_controls.double() - self.lower) / self.range

    def __call__(self, controls: Float[Tensor, "frame control"], steps: int) -> tuple[Tensor, Tensor]:
        """The controls `(frame, control)`, and the shapes `(driver, vertex, 3)`, after at most so many steps."""
        units = ((controls.double() - self.lower) / self.range).clamp(0, 1)
        shapes = self.span.target.new_zeros(self.count, self.span.target.shape[1])
        damping, cost = DAMPING, self._cost(units, shapes)
        for _ in range(steps):
            linearised = _Linearised(self, units, shapes)
            while True:
                more_units, more_shapes = linearised.step(damping)
                tried = (units + more_units).clamp(0, 1), shapes + more_shapes
                found = self._cost(*tried)
                if found < cost or damping > MOST_DAMPING:
                    break
                damping *= MORE
            if not found < cost:
                break
            gain, cost, (units, shapes) = cost - found, found, tried
            damping = max(LESS * damping, LEAST_DAMPING)
            if gain < GAINS_LITTLE * cost:
                break
        full = (shapes @ self.span.directions).unflatten(1, (-1, 3))
        return self.controls(units), full.float()

    def controls(self, units: Tensor) -> Tensor:
        """Controls of fractions of their ranges."""
        return (self.lower + self.range * units).to(self.rig.dtype).clamp(self.rig.lower, self.rig.upper)

    def error(self, coefficients: Tensor, shapes: Tensor) -> Tensor:
        """The target minus the mesh of coefficients, with shapes, `(frame, coordinate)`."""
        return self.span.target - coefficients.double() @ torch.cat([self.span.basis, shapes])

    def _cost(self, units: Tensor, shapes: Tensor) -> float:
        error = self.error(self.rig.coefficients(self.controls(units)), shapes)
        return float(0.5 * error.square().sum() / self.vertices + SPARSITY * (units - self.neutral).abs().sum())


class _Linearised:
    """The model of a joint fit around some controls and shapes."""

    def __init__(self, fit: JointFit, units: Tensor, shapes: Tensor) -> None:
        coefficients, jacobian = fit.rig.coefficient_jacobian(fit.controls(units))
        self.error = fit.error(coefficients, shapes)
        self.columns = self._columns(fit, jacobian, shapes)
        away = units - fit.neutral
        sign = torch.where(fit.neutral <= 0, 1.0, torch.where(fit.neutral >= 1, -1.0, away.sign()))
        self.descent = (self.columns @ self.error[..., None])[..., 0] - SPARSITY * fit.vertices * sign
        self.free = ~(((units <= 0) & (self.descent < 0)) | ((units >= 1) & (self.descent > 0)))
        self.columns = self.columns * self.free[..., None]
        self.descent = self.descent * self.free
        self.gram = self.columns @ self.columns.mT
        self.floor = FLOOR * fit.vertices
        weights = coefficients[:, -fit.count :].double()
        self.scale = weights.norm(dim=0).clamp_min(1e-6)
        self.weights = weights / self.scale

    @staticmethod
    def _columns(fit: JointFit, jacobian: Jacobian, shapes: Tensor) -> Tensor:
        """The derivatives `(frame, control, coordinate)` by controls as fractions of their ranges."""
        rows = torch.cat([fit.span.basis, shapes])
        return (jacobian.dense().mT @ rows.to(fit.rig.dtype)).double() * fit.range[:, None]

    def step(self, damping: float) -> tuple[Tensor, Tensor]:
        """Changes of the controls, as fractions of their ranges, and of the shapes."""
        diagonal = self.gram.diagonal(dim1=1, dim2=2)
        added = torch.where(self.free, damping * diagonal + self.floor, 1.0)
        factor = torch.linalg.cholesky(self.gram + torch.diag_embed(added))

        def solve(right: Tensor) -> Tensor:
            return torch.cholesky_solve(right[..., None], factor)[..., 0]

        def made(units: Tensor) -> Tensor:
            return (self.columns.mT @ units[..., None])[..., 0]

        def outside(meshes: Tensor) -> Tensor:
            return meshes - made(solve((self.columns @ meshes[..., None])[..., 0]))

        def normal(shapes: Tensor) -> Tensor:
            return self.weights.T @ outside(self.weights @ shapes) + (damping + RIDGE) * shapes

        right = self.weights.T @ (self.error - made(solve(self.descent)))
        shapes = conjugate_gradients(normal, right, INNER_STEPS)
        units = solve(self.descent - (self.columns @ (self.weights @ shapes)[..., None])[..., 0])
        return units * self.free, shapes / self.scale[:, None]
