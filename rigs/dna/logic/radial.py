"""Radial basis functions: poses of some controls, each with a weight that decreases with the distance from it.

Computed in float64, except that for float32 controls arcs between quaternions are rounded as in the reference, which computes
them in float32 (four digits for nearly equal quaternions). Derivatives ignore the rounding.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format.later_layers import PoseOutput, RadialBasis, RadialBasisOutputs, Solver
from rigs.dna.logic.layout import Layout, Stage, put
from rigs.dna.logic.nets import check_outputs
from rigs.dna.logic.rotations import conjugate, multiply, twist_of

INTERPOLATIVE, GIVEN_RADIUS, ALWAYS = 1, 1, 1
EUCLIDEAN, SWING, TWIST = 0, 2, 3
MOST_CONDITION = 1e12  # of the kernel between poses
LIMITS = {"kind": 2, "automatic_radius": 2, "distance": 4, "normalise": 2, "function": 5, "axis": 3}


class RadialSolver(Stage):
    """A solver: from all controls to all controls, with the outputs of its poses.

    Raises:
        InputError: it is damaged, or its poses are indistinguishable.
    """

    controls: Tensor
    values: Tensor
    scales: Tensor
    written: Tensor
    matrix: Tensor
    factors: Tensor
    inverse: Tensor
    rounded_inverse: Tensor

    def __init__(self, layout: Layout, what: str, solver: Solver, scales: np.ndarray, outputs: Sequence[PoseOutput]) -> None:
        super().__init__()
        for name, limit in LIMITS.items():
            if getattr(solver, name) >= limit:
                raise layout.wrong(f"{what} has {name} {getattr(solver, name)}, expected 0 to {limit - 1}")
        poses, width = len(solver.poses), len(solver.controls)
        if not poses or not width or len(solver.values) != poses * width:
            raise layout.wrong(f"{what} has {len(solver.values)} values, expected {poses} poses x {width} controls")
        if solver.distance != EUCLIDEAN and width % 4:
            raise layout.wrong(f"{what} measures quaternions, four controls each, and has {width} controls")
        layout.check_controls(what, solver.controls)
        layout.check_room(what, poses, poses, width)
        layout.check_finite(what, np.concatenate([solver.values, [solver.radius, solver.threshold], scales]))
        self.solver, self.rounds = solver, False
        values = solver.values.reshape(poses, width).astype(np.float64)
        self.keep(controls=solver.controls.astype(int), values=values, scales=scales.astype(np.float64))
        self._keep_outputs(layout, what, outputs)
        self.radii = tuple(self._radius(rounds) for rounds in (False, True))
        if not min(self.radii) > 0:
            raise layout.wrong(f"{what} has a radius of {min(self.radii):g}, expected more than 0")
        if solver.kind == INTERPOLATIVE:
            kernels = [self._kernel(self._distances(self.values, rounds), rounds) for rounds in (False, True)]
            if max(float(torch.linalg.cond(kernel)) for kernel in kernels) > MOST_CONDITION:
                raise layout.wrong(f"{what} has poses that cannot be told apart")
            self.keep(inverse=torch.linalg.inv(kernels[0]), rounded_inverse=torch.linalg.inv(kernels[1]))

    def _radius(self, rounds: bool) -> float:
        """Radius of the kernel: the file's, or the mean distance between two poses."""
        if self.solver.automatic_radius == GIVEN_RADIUS:
            return float(np.deg2rad(self.solver.radius))
        poses = len(self.values)
        pairs = torch.triu(torch.ones(poses, poses, dtype=torch.bool), diagonal=1)
        return float(self._distances(self.values, rounds)[pairs].mean()) if poses > 1 else 0.0

    def _keep_outputs(self, layout: Layout, what: str, outputs: Sequence[PoseOutput]) -> None:
        """Register the controls that multiply each pose's weight, and the matrix from poses to outputs."""
        written = np.unique(np.concatenate([one.outputs for one in outputs] or [np.zeros(0)]).astype(np.int64))
        check_outputs(layout, what, written)
        most = max((len(one.inputs) for one in outputs), default=0)
        layout.check_room(what, len(outputs), most + len(written))
        factors = np.full((len(outputs), most), layout.total)  # index of a 1 after the last control
        matrix = np.zeros((len(outputs), len(written)))
        for row, one in enumerate(outputs):
            layout.check_lengths(f"pose {row} of {what}", outputs=len(one.outputs), weights=len(one.weights))
            layout.check_controls(f"pose {row} of {what}", one.inputs)
            layout.check_finite(f"pose {row} of {what}", one.weights)
            np.add.at(matrix[row], np.searchsorted(written, one.outputs), one.weights)
            factors[row, : len(one.inputs)] = one.inputs
        self.keep(written=written, matrix=matrix, factors=factors)

    def forward(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)`, with the outputs of the poses replaced."""
        controls = controls.index_fill(1, self.written, 0.0)
        precise = controls.double()
        rounds = self.rounds or controls.dtype == torch.float32
        weights = self._weights(precise.index_select(1, self.controls), rounds)
        padded = torch.cat([precise, precise.new_ones(len(precise), 1)], dim=1)
        for slot in self.factors.T:
            weights = weights * padded.index_select(1, slot)
        return put(controls, self.written, (weights @ self.matrix.double()).to(controls))

    def _weights(self, inputs: Tensor, rounds: bool) -> Tensor:
        """Weights of the poses, `(batch, pose)`."""
        weights = self._kernel(self._distances(inputs, rounds), rounds)
        if self.solver.kind == INTERPOLATIVE:
            inverse = self.rounded_inverse if rounds else self.inverse
            weights = (weights @ inverse.double()).clamp(0, 1)
        total = weights.sum(dim=1, keepdim=True)
        divided = torch.ones_like(total, dtype=torch.bool) if self.solver.normalise == ALWAYS else total > 1
        weights = weights / torch.where(divided & (total != 0), total, 1.0) * self.scales.double()
        return torch.where(weights > float(self.solver.threshold), weights, 0.0)

    def _distances(self, inputs: Tensor, rounds: bool) -> Tensor:
        """Distances from inputs `(batch, control)` to each pose, `(batch, pose)`; `rounds`: arcs in float32."""
        values = self.values.double()
        if self.solver.distance == EUCLIDEAN:
            return _root((inputs[:, None] - values).square().sum(dim=2))
        one, other = (self._part(given.unflatten(1, (-1, 4))) for given in (inputs, values))
        arcs = _squared_arcs(torch.einsum("bgc,pgc->bpg", one, other))
        if rounds:
            arcs = arcs + (_rounded_arcs(one, other) - arcs).detach()
        return _root(arcs.sum(dim=2))

    def _part(self, quaternions: Tensor) -> Tensor:
        """The compared part of quaternions `(batch, group, 4)`: all, the swing or the twist."""
        if self.solver.distance not in (SWING, TWIST):
            return quaternions
        twist = twist_of(quaternions, self.solver.axis)
        return twist if self.solver.distance == TWIST else multiply(quaternions, conjugate(twist))

    def _kernel(self, distances: Tensor, rounds: bool) -> Tensor:
        radius, function = self.radii[rounds], self.solver.function
        relative = distances / radius
        if function == 0:
            return torch.exp(-distances / radius**2)
        if function == 1:
            return torch.exp(-2 * relative)
        return (1 - relative ** (1, 3, 5)[function - 2]).clamp_min(0)


def _squared_arcs(cosines: Tensor) -> Tensor:
    """The square of arccos(2 c^2 - 1) for cosines of half arcs, 0 above 1; its gradient is finite everywhere."""
    inside = cosines.square() < 1
    sizes = torch.where(inside, cosines, 0.0).abs()
    sines = (1 - sizes.square()).sqrt()
    return torch.where(inside, (2 * torch.atan2(sines, sizes)).square(), 0.0)


@torch.no_grad()
def _rounded_arcs(one: Tensor, other: Tensor) -> Tensor:
    """Squared arcs `(batch, pose, group)` of quaternions in float32, in the order of operations of the reference."""
    one, other = one.float()[:, None], other.float()
    products = [one[..., part] * other[..., part] for part in range(4)]
    cosines = products[0] + products[1] + products[2] + products[3]
    squares = cosines.square()
    return torch.where(squares > 1, 0.0, torch.arccos(2 * squares - 1).square()).double()


def _root(squares: Tensor) -> Tensor:
    """Square root with gradient 0 at 0."""
    positive = squares > 0
    return torch.where(positive, torch.where(positive, squares, 1.0).sqrt(), 0.0)


class RadialSolvers(Stage):
    """The solvers of a level of detail, evaluated in order.

    Raises:
        InputError: a solver is damaged.
    """

    def __init__(self, layout: Layout, radial: RadialBasis, outputs: RadialBasisOutputs | None, lod: int) -> None:
        super().__init__()
        chosen = layout.rows_of_lod("the solvers", radial.lod_solvers, lod, len(radial.solvers), "solvers")
        self.solvers: torch.nn.ModuleList = torch.nn.ModuleList()
        for solver in (radial.solvers[number] for number in chosen.tolist()):
            what = f"solver {solver.name[:60]!r}"
            layout.check(what, solver.poses, len(radial.poses), "poses")
            if outputs is not None:
                layout.check(f"an output of {what}", solver.poses, len(outputs.poses), "poses")
            numbers = solver.poses.tolist()
            scales = np.array([radial.poses[number].scale for number in numbers], dtype=np.float64)
            written = [outputs.poses[number] if outputs is not None else _own(layout, number) for number in numbers]
            self.solvers.append(RadialSolver(layout, what, solver, scales, written))

    def round_as_reference(self) -> None:
        """Round arcs for float64 controls, too."""
        for solver in self.solvers:
            solver.rounds = True  # type: ignore[assignment]  # an attribute of RadialSolver, which the type of ModuleList does not show

    def forward(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)`, with the outputs of all solvers."""
        for solver in self.solvers:
            controls = solver(controls)
        return controls


def _own(layout: Layout, pose: int) -> PoseOutput:
    """Output of a pose in files before version 2.5: the RBF control of the same index."""
    return PoseOutput(np.zeros(0, np.uint16), np.array([layout.rbfs.start + pose]), np.ones(1, np.float32))
