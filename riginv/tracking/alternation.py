"""One window of a clip: rigid motion, missing vertices and controls, each estimated from the others in alternation.

Alternation minimises the distance of the known vertices over controls and rigid motion together; the rig at the current
controls fills in unknown vertices.
"""

import functools
from dataclasses import dataclass

import roma
import torch
from torch import Tensor

from riginv.geometry.kinematics import remove_motion
from riginv.rig.interface import LinearRig
from riginv.tracking.anchors import Anchors
from riginv.tracking.estimators import ControlEstimator
from riginv.tracking.rigid import fit_rigid, rigid_change

MIN_KNOWN = 0.02  # fraction of the vertices that must be known to solve a frame
MIN_KNOWN_VERTICES = 3
KEY_STRIDE = 8  # between the frames of a window that are solved first


def is_finite(values: Tensor) -> bool:
    """Whether values are all finite, and no more than a sum of them can hold; faster than a look at each."""
    return bool(values.sum().isfinite())


def interpolate_controls(controls: Tensor, known: Tensor, numbers: Tensor) -> Tensor:
    """Controls `(frame, control)`, interpolated linearly between known frames `(frame,)`.

    Args:
        numbers: frame numbers `(frame,)`.
    """
    before, after, fraction = _neighbours(known, numbers)
    return controls[before] + fraction[:, None].to(controls) * (controls[after] - controls[before])


def interpolate_motion(motion: Tensor, known: Tensor, numbers: Tensor) -> Tensor:
    """Rigid motions `(frame, 4, 4)`, interpolated likewise; rotations along the shortest arc."""
    before, after, fraction = _neighbours(known, numbers)
    result = interpolate_controls(motion.flatten(1), known, numbers).unflatten(1, (4, 4))
    rotation = roma.rotvec_to_rotmat(
        fraction[:, None].to(motion) * roma.rotmat_to_rotvec(motion[before, :3, :3].mT @ motion[after, :3, :3])
    )
    result[:, :3, :3] = torch.where(known[:, None, None], motion[:, :3, :3], motion[before, :3, :3] @ rotation)
    return result


def _neighbours(known: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For each frame the known frames before and after it, and its position between them in [0, 1]."""
    frames = torch.arange(len(known))
    last = torch.where(known, frames, -1).cummax(dim=0).values
    next_one = torch.where(known, frames, len(known)).flip(0).cummin(dim=0).values.flip(0)
    before = torch.where(last < 0, next_one, last)
    after = torch.where(next_one == len(known), last, next_one)
    distance = (numbers[after] - numbers[before]).clamp_min(1)
    return before, after, (numbers - numbers[before]).double() / distance


@dataclass
class WindowResult:
    """The result of a window; meshes without rigid motion are computed on first use.

    Attributes:
        rig: that was fitted.
        vertices: the meshes, `(frame, vertex, 3)`; NaN where a vertex is not known.
        controls: `(frame, control)`; neutral where the frame cannot be solved.
        motion: `(frame, 4, 4)` from the rig's mesh to the world; None where rigid motion is kept.
        solvable: whether enough vertices are known to solve the frame, `(frame,)`.
    """

    rig: LinearRig
    vertices: Tensor
    controls: Tensor
    motion: Tensor | None
    solvable: Tensor

    @functools.cached_property
    @torch.no_grad()
    def stabilised(self) -> Tensor:
        """The meshes without rigid motion, `(frame, vertex, 3)`; NaN where a vertex is not known."""
        return self.vertices if self.motion is None else remove_motion(self.motion, self.vertices)

    @functools.cached_property
    @torch.no_grad()
    def recovered(self) -> Tensor:
        """The rig at the controls, `(frame, vertex, 3)`."""
        return self.rig(self.controls)

    @functools.cached_property
    @torch.no_grad()
    def filled(self) -> Tensor:
        """`stabilised` itself where all vertices are known, else with the rig's mesh where a vertex is not."""
        stabilised = self.stabilised
        if is_finite(stabilised):
            return stabilised
        return torch.where(torch.isfinite(stabilised).all(dim=2, keepdim=True), stabilised, self.recovered)


class WindowInverter:
    """Inverts windows of a clip.

    Args:
        rig: to fit.
        estimator: from filled meshes to controls.
        anchors: vertices that rigid motion is estimated from; None: it is kept.
        weights: of the vertices, `(vertex,)` in [0, 1], for an estimator that does not weight them itself.
        iterations: of rigid motion, missing vertices and controls, at most.
    """

    def __init__(
        self, rig: LinearRig, estimator: ControlEstimator, anchors: Anchors | None, weights: Tensor | None, iterations: int
    ) -> None:
        self.rig, self.estimator, self.anchors, self.weights, self.iterations = rig, estimator, anchors, weights, iterations

    @torch.no_grad()
    def invert(self, vertices: Tensor) -> WindowResult:
        """Invert meshes `(frame, vertex, 3)`, mm; NaN where a vertex is not known."""
        known = torch.ones(vertices.shape[:2], dtype=torch.bool)
        if not is_finite(vertices):
            known = torch.isfinite(vertices).all(dim=2)
        solvable = (known.float().mean(dim=1) >= MIN_KNOWN) & (known.sum(dim=1) >= MIN_KNOWN_VERTICES)
        controls = self.rig.neutral_controls.expand(len(vertices), -1).clone()
        motion = None if self.anchors is None else torch.eye(4).expand(len(vertices), -1, -1).clone()
        rows = solvable.nonzero()[:, 0]
        if len(rows):
            every = len(rows) == len(vertices)
            alternation = _AlternatingSolve(self, vertices if every else vertices[rows], known[rows])
            controls[rows] = alternation.solve()
            if motion is not None and alternation.rigid is not None:
                motion[rows] = alternation.rigid.motion
        result = self.result(vertices, controls, motion, solvable)
        if self.estimator.has_final_steps and len(rows):
            controls[rows] = self.estimator.finish(result.filled[rows], controls[rows])
            result = self.result(vertices, controls, motion, solvable)
        return result

    def result(self, vertices: Tensor, controls: Tensor, motion: Tensor | None, solvable: Tensor) -> WindowResult:
        """The result for given controls and motion."""
        return WindowResult(self.rig, vertices, controls, motion, solvable)


class _RigidState:
    """The rigid motion of some frames, and the rig's anchors it was fitted to."""

    def __init__(self, anchors: Anchors, vertices: Tensor) -> None:
        self.anchors = anchors
        self.positions = anchors.rest.expand(len(vertices), -1, -1).clone()
        self.motion = fit_rigid(self.positions, vertices[:, anchors.vertices], anchors.weights)

    def update(self, rows: Tensor, positions: Tensor, target: Tensor) -> Tensor:
        """Fit the motion of frames to new anchors `(row, anchor, 3)`; returns the anchors' mean displacement `(row,)`, mm."""
        before = self.motion[rows]
        motion = fit_rigid(positions, target[:, self.anchors.vertices], self.anchors.weights, before)
        change = rigid_change(before, self.positions[rows], motion, positions)
        self.motion[rows], self.positions[rows] = motion, positions
        return change


class _AlternatingSolve:
    """The alternation for frames that can all be solved."""

    def __init__(self, inverter: WindowInverter, vertices: Tensor, known: Tensor) -> None:
        self.inverter, self.vertices, self.known = inverter, vertices, known
        rig = inverter.rig
        is_complete = bool(known.all()) and inverter.weights is None  # then the rig is evaluated at the anchors alone
        self.controls = rig.neutral_controls.expand(len(vertices), -1).clone()
        self.recovered = None if is_complete else rig.rest_vertices.expand_as(vertices).clone()
        self.rigid = _RigidState(inverter.anchors.for_window(known), vertices) if inverter.anchors is not None else None

    def solve(self) -> Tensor:
        """Iterate until every frame has converged; the controls `(frame, control)`."""
        rows = torch.arange(len(self.vertices))
        if self.recovered is None and self.rigid is None:
            self._iterate(rows, 0)
            return self.controls
        if self.inverter.estimator.frames_are_independent and self.recovered is None and len(rows) > 2 * KEY_STRIDE:
            keys = rows[::KEY_STRIDE]
            self._converge(keys)
            self._start_from(keys)
        self._converge(rows)
        return self.controls

    def _converge(self, rows: Tensor) -> None:
        for iteration in range(self.inverter.iterations):
            rows = rows[self._iterate(rows, iteration)] if len(rows) else rows

    def _start_from(self, keys: Tensor) -> None:
        """Fit the motion of all frames to the anchors at controls that are interpolated between key frames."""
        rows = torch.arange(len(self.vertices))
        is_key = torch.zeros(len(rows), dtype=torch.bool).index_fill_(0, keys, True)
        self.controls = interpolate_controls(self.controls, is_key, rows)
        self._update(rows)

    def _iterate(self, rows: Tensor, iteration: int) -> Tensor:
        """One iteration for some frames; whether each needs another."""
        vertices = self.vertices if len(rows) == len(self.vertices) else self.vertices[rows]
        motion = None if self.rigid is None else self.rigid.motion[rows]
        estimator, weights = self.inverter.estimator, self.inverter.weights
        if self.recovered is not None:
            vertices, motion = vertices if motion is None else remove_motion(motion, vertices), None
            recovered = self.recovered[rows]
            vertices = torch.where(self.known[rows][..., None], vertices, recovered)
            if weights is not None:
                vertices = recovered + weights[:, None] * (vertices - recovered)
        refined = estimator.refine(vertices, self.controls[rows], motion) if iteration else estimator.estimate(vertices, motion)
        self.controls[rows] = refined
        return self._update(rows) > estimator.tolerance_mm

    def _update(self, rows: Tensor) -> Tensor:
        """Evaluate the rig at new controls and refit the motion; the mean displacement of the vertices `(row,)`, mm."""
        controls, recovered = self.controls[rows], None
        change = torch.zeros(len(rows))
        if self.recovered is not None:
            recovered = self.inverter.rig(controls)
            change = (recovered - self.recovered[rows]).norm(dim=2).mean(dim=1)
            self.recovered[rows] = recovered
        if self.rigid is not None:
            anchors = self.rigid.anchors
            positions = anchors.mesh(controls) if recovered is None else recovered[:, anchors.vertices]
            change = self.rigid.update(rows, positions, self.vertices[rows])
        return change
