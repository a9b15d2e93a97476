"""A static offset of a mesh, found together with the controls and the rigid motion of many frames.

An actor differs from the rig by a field o, the same in every frame. With the neutral N = rest + o, the rig's displacement D(r)
and rigid transforms T_t that take the frames y_t into the rig's space, the sum over frames of

    half of |N + D(r_t) - T_t y_t|^2  +  the priors of r_t

is minimised over all of it together by Gauss-Newton steps. The normal equations have the shape of an arrow: a block for each
frame's controls and motion, and mesh coordinates of the field, which couple them. The frames are eliminated from it; the part
of the field outside the mesh space is the mean of the frames' residuals. Solving for field and controls in turns does not
converge in any reasonable number of iterations.
"""

from dataclasses import dataclass
from functools import partial

import roma
import torch
from jaxtyping import Float
from torch import Tensor

from riginv.solvers.box_step import FLOOR
from riginv.solvers.objective import Objective
from riginv.solvers.starts import start_by_derivative

START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-6, 1e4
ROUNDS = 3  # of solving, and fixing controls that leave the box
LONGEST_STEP = 0.2  # as a fraction of a control's range
MOTION_DAMPING = 1e-6  # relative; makes the common motion of field and frames, which costs nothing, definite
TOLERANCE = 1e-4  # a step that reduces the cost by less than this fraction counts as idle
IDLE = 3
BATCH_SIZE = 16  # frames


@dataclass
class OffsetSolution:
    """The static field and the frames that were solved with it.

    Attributes:
        neutral: the actor's neutral in the rig's space, `(vertex, 3)`, mm.
        units: controls as fractions of their ranges, `(frame, control)`.
        vertices: the frames in the rig's space, without rigid motion, `(frame, vertex, 3)`, mm.
        cost: the sum over frames.
        steps: Gauss-Newton steps that were taken.
    """

    neutral: Tensor
    units: Tensor
    vertices: Tensor
    cost: float = float("inf")
    steps: int = 0


class OffsetSolver:
    """Solves for a static offset.

    Args:
        objective: of the controls, in the mesh space of the rig.
        moves: whether each frame has a rigid motion of its own.
        is_free: whether the field is unknown; else the neutral is given up to a rotation, which head motion leaves open.
    """

    def __init__(self, objective: Objective, moves: bool, is_free: bool) -> None:
        self.objective, self.moves, self.is_free = objective, moves, is_free
        self.frame = objective.rig.space.directions.flatten(1)

    @torch.no_grad()
    def solve(
        self,
        vertices: Float[Tensor, "frame vertex 3"],
        neutral: Float[Tensor, "vertex 3"],
        steps: int,
        units: Float[Tensor, "frame control"] | None = None,
    ) -> OffsetSolution:
        """Minimise from frames that are roughly without rigid motion.

        Args:
            vertices: mm; NaN where a vertex is not known.
            neutral: to start from, or the given one.
            steps: at most.
            units: controls to start from, as fractions of their ranges; None: by the derivative at the rig's neutral.
        """
        is_known = torch.isfinite(vertices).all(dim=2, keepdim=True)
        filled = torch.where(is_known, vertices, neutral)
        if units is None:
            units = start_by_derivative(self.objective, self._coordinates(filled, neutral))
        at = OffsetSolution(neutral, units, filled)
        at = self._settled(at, is_known)
        damping, idle = START_DAMPING, 0
        while at.steps < steps and idle < IDLE and damping < MOST_DAMPING:
            near = self._linearise(at)
            before = at.cost
            while damping < MOST_DAMPING:
                step = near.step(at.units, damping)
                solution = at if step is None else self._settled(self._moved(at, *step), is_known)
                if solution.cost < before:
                    damping, at = max(damping / 5, LEAST_DAMPING), solution
                    break
                damping *= 4
            at.steps += 1
            idle = idle + 1 if before - at.cost < TOLERANCE * before else 0
        return at

    @torch.no_grad()
    def residual_mm(self, at: OffsetSolution) -> float:
        """The root mean square distance of the frames' vertices from the solution, mm."""
        residual = at.neutral + self._displacement(at.units) - at.vertices
        return float(residual.square().sum(dim=2).mean().sqrt())

    def _coordinates(self, vertices: Tensor, neutral: Tensor) -> Tensor:
        return (vertices - neutral).flatten(1) @ self.frame.T

    def _displacement(self, units: Tensor) -> Tensor:
        rig = self.objective.rig.source
        controls = (self.objective.lower + self.objective.span * units).to(rig.dtype)
        return torch.cat([rig(batch) - rig.rest_vertices for batch in controls.split(BATCH_SIZE)])

    def _settled(self, at: OffsetSolution, known: Tensor) -> OffsetSolution:
        """The same controls and motion with the best field for them, unknown vertices filled, and their cost."""
        displacement = self._displacement(at.units)
        neutral = at.neutral
        if self.is_free:
            count = known.sum(dim=0).clamp_min(1)
            best = torch.where(known, at.vertices - displacement, 0.0).sum(dim=0) / count
            neutral = torch.where(known.any(dim=0), best, neutral)
        vertices = torch.where(known, at.vertices, neutral + displacement)
        coordinates = self._coordinates(vertices, neutral)
        outside = ((vertices - neutral).flatten(1) - coordinates @ self.frame).square().sum()  # no difference of large sums
        cost = float(self.objective.cost(at.units, coordinates).sum() + 0.5 * outside)
        return OffsetSolution(neutral, at.units, vertices, cost, at.steps)

    def _moved(self, at: OffsetSolution, units: Tensor, motion: Tensor | None, shared: Tensor) -> OffsetSolution:
        """Take a step: new controls, rigid motion `(frame, 6)`, and where the neutral is given its rotation, `(3,)`."""
        centre, radius = _centre(at.neutral)
        vertices, neutral = at.vertices, at.neutral
        if motion is not None:
            vertices = _rotated(vertices, motion, centre, radius)
        if not self.is_free:
            pose = torch.nn.functional.pad(shared, (0, 3))[None]
            neutral = _rotated(neutral[None], pose, centre, radius)[0]
        return OffsetSolution(neutral, units, vertices, at.cost, at.steps)

    def _linearise(self, at: OffsetSolution) -> "Arrow":
        objective, frames = self.objective, len(at.units)
        centre, radius = _centre(at.neutral)
        rigid = _generators(at.neutral[None], centre, radius)[0]
        basis = self._basis(rigid)
        residual = (at.neutral + self._displacement(at.units) - at.vertices).flatten(1)
        batches = zip(at.units.split(BATCH_SIZE), self._coordinates(at.vertices, at.neutral).split(BATCH_SIZE))
        near = objective.run_tasks([partial(objective.linearise, *batch) for batch in batches])
        gradient, hessian = (torch.cat([batch[number] for batch in near]).double() for number in (1, 2))
        coupling = self._control_columns(at.units, len(basis))
        if self.moves:
            moved = zip(at.vertices.split(BATCH_SIZE), residual.split(BATCH_SIZE))
            terms = [_motion_terms(_generators(some, centre, radius), rest, basis) for some, rest in moved]
            columns, corner, slope = (torch.cat(values) for values in zip(*terms))
            between = (coupling.mT @ columns).double()
            hessian = torch.cat([torch.cat([hessian, between], 2), torch.cat([between.mT, corner], 2)], 1)
            gradient, coupling = torch.cat([gradient, slope], 1), torch.cat([coupling, columns], 2)
        shared_slope = (basis @ residual.sum(dim=0)).double()
        if self.is_free:
            own = frames * torch.eye(len(basis), dtype=torch.float64)
            return Arrow(hessian, gradient, coupling.mT.double(), own, shared_slope, objective.controls)
        rotations = rigid[:3]
        field = basis @ rotations.T  # (coordinate, 3)
        own = frames * (rotations @ rotations.T).double()
        return Arrow(hessian, gradient, (coupling.mT @ field).double(), own, shared_slope @ field.double(), objective.controls)

    def _control_columns(self, units: Tensor, coordinates: int) -> Tensor:
        """The derivatives of mesh coordinates, `(frame, coordinate, control)`; 0 for those beyond the mesh space."""
        objective, found = self.objective, []
        for batch in units.split(BATCH_SIZE):
            _, jacobian = objective.rig.source.coefficient_jacobian(objective.lower + objective.span * batch)
            found.append(objective.map.T @ jacobian.scaled(objective.span).dense())
        return torch.nn.functional.pad(torch.cat(found), (0, 0, 0, coordinates - len(self.frame)))

    def _basis(self, rigid: Tensor) -> Tensor:
        """The mesh space's frame, extended by rigid motion of the neutral, `(coordinate, 3 vertex)`."""
        if not self.moves:
            return self.frame
        outside = rigid - (rigid @ self.frame.T) @ self.frame
        rest, sizes, _ = torch.linalg.svd(outside.double().T, full_matrices=False)
        kept = sizes > 1e-4 * rigid.norm(dim=1).max()
        return torch.cat([self.frame, rest[:, kept].T.to(self.frame)])


@dataclass
class Arrow:
    """Normal equations: a block for each frame, a shared block, and what couples them; all in float64.

    Attributes:
        hessian, gradient: of each frame, `(frame, unknown, unknown)`, `(frame, unknown)`.
        coupling: `(frame, unknown, shared)`.
        own, slope: of the shared unknowns, `(shared, shared)`, `(shared,)`.
        controls: number of the unknowns of a frame that are controls in [0, 1]; the others are its motion.
    """

    hessian: Tensor
    gradient: Tensor
    coupling: Tensor
    own: Tensor
    slope: Tensor
    controls: int

    def step(self, at: Tensor, damping: float) -> tuple[Tensor, Tensor | None, Tensor] | None:
        """The controls after a step within the box, the motion of each frame, and the shared unknowns.

        None where a block is not positive definite.
        """
        diagonal = self.hessian.diagonal(dim1=1, dim2=2)
        floor = FLOOR * diagonal[:, : self.controls].mean(dim=1, keepdim=True) + 1e-12
        added = damping * (diagonal + floor)
        added[:, self.controls :] = MOTION_DAMPING * diagonal[:, self.controls :]
        slope = self.gradient[:, : self.controls]
        free = ~(((at <= 0) & (slope > 0)) | ((at >= 1) & (slope < 0)))
        pinned = torch.zeros_like(self.gradient)
        for _ in range(ROUNDS):
            every = torch.nn.functional.pad(free, (0, self.gradient.shape[1] - self.controls), value=True)
            try:
                unknowns, shared = self.solve(added, every, pinned)
            except torch.linalg.LinAlgError:
                return None
            target = at + unknowns[:, : self.controls]
            leaving = free & ((target < 0) | (target > 1))
            if not bool(leaving.any()):
                break
            free = free & ~leaving
            pinned[:, : self.controls] = torch.where(free, 0.0, target.clamp(0, 1) - at)
        change = (target.clamp(0, 1) - at).clamp(-LONGEST_STEP, LONGEST_STEP)
        motion = unknowns[:, self.controls :] if unknowns.shape[1] > self.controls else None
        return (at + change).to(at), None if motion is None else motion.to(at), shared.to(at)

    def solve(self, added: Tensor, free: Tensor, pinned: Tensor) -> tuple[Tensor, Tensor]:
        """The frames' unknowns `(frame, unknown)` and the shared ones `(shared,)`, by elimination of the frames.

        Args:
            added: to the diagonals of the frames' blocks.
            free: which unknowns are solved for; the others are `pinned`.
        """
        right = torch.where(free, -self.gradient - (self.hessian @ pinned[..., None])[..., 0], 0.0)
        shared_right = -self.slope - (self.coupling.mT @ pinned[..., None])[..., 0].sum(dim=0)
        reduced, halves = self.own.clone(), []
        factors = []
        for frame in range(len(right)):
            rows = free[frame].nonzero()[:, 0]
            block = self.hessian[frame][rows][:, rows] + torch.diag(added[frame, rows])
            factor = torch.linalg.cholesky(block)
            columns = torch.cat([self.coupling[frame, rows], right[frame, rows, None]], dim=1)
            half = torch.linalg.solve_triangular(factor, columns, upper=False)
            reduced -= half[:, :-1].T @ half[:, :-1]
            shared_right = shared_right - half[:, :-1].T @ half[:, -1]
            factors.append((rows, factor))
            halves.append(half)
        reduced.diagonal().add_(1e-9 * reduced.diagonal().mean())
        shared = torch.linalg.solve(reduced, shared_right)
        unknowns = pinned.clone()
        for frame, ((rows, factor), half) in enumerate(zip(factors, halves)):
            value = half[:, -1:] - half[:, :-1] @ shared[:, None]
            unknowns[frame, rows] = torch.linalg.solve_triangular(factor.T, value, upper=True)[:, 0]
        return unknowns, shared


def _centre(neutral: Tensor) -> tuple[Tensor, float]:
    centre = neutral.mean(dim=0)
    return centre, float((neutral - centre).square().sum(dim=1).mean().sqrt())


def _generators(vertices: Tensor, centre: Tensor, radius: float) -> Tensor:
    """Displacements by small rotations, scaled to about 1 mm, and by translations, `(frame, 6, 3 vertex)`."""
    axes = torch.eye(3).to(vertices)
    rotations = [torch.linalg.cross(axis.expand_as(vertices), (vertices - centre) / radius, dim=-1) for axis in axes]
    shifts = [axis.expand_as(vertices) for axis in axes]
    return torch.stack([*rotations, *shifts], dim=1).flatten(2)


def _motion_terms(generators: Tensor, residual: Tensor, basis: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Derivatives of the residual by rigid motion in coordinates `(frame, coordinate, 6)`, their squares and the gradient."""
    exact = generators.double()
    slope = -(exact @ residual.double()[..., None])[..., 0]
    return -(generators @ basis.T).mT, exact @ exact.mT, slope


def _rotated(vertices: Tensor, motion: Tensor, centre: Tensor, radius: float) -> Tensor:
    """Meshes after rigid motions `(frame, 6)` in the units of `_generators`."""
    rotation = roma.rotvec_to_rotmat(motion[:, :3] / radius)
    return (vertices - centre) @ rotation.mT + centre + motion[:, None, 3:]
