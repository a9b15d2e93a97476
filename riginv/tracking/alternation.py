"""One window of a clip: rigid motion, missing vertices and controls, each found by the others, in turns.

The controls tell where unseen vertices are, and how far the face has moved in itself; the rest is rigid motion. Taking turns
minimises the distance of the vertices that were seen, over controls and motion together.
"""

from dataclasses import dataclass

import roma
import torch
from torch import Tensor

from riginv.rig.interface import LinearRig
from riginv.tracking.anchors import Anchors
from riginv.tracking.estimators import ControlEstimator
from riginv.tracking.rigid import apply_motion, fit_rigid, remove_motion


def interpolate_controls(controls: Tensor, known: Tensor, numbers: Tensor) -> Tensor:
    """Controls `(frame, control)`, on a straight line between the nearest known frames where they are not known `(frame,)`.

    Args:
        numbers: of the frames, `(frame,)`, as time goes by.
    """
    before, after, share = _neighbours(known, numbers)
    return controls[before] + share[:, None].to(controls) * (controls[after] - controls[before])


def interpolate_motion(motion: Tensor, known: Tensor, numbers: Tensor) -> Tensor:
    """Rigid motions `(frame, 4, 4)`, likewise; rotations go the shortest way."""
    before, after, share = _neighbours(known, numbers)
    result = interpolate_controls(motion.flatten(1), known, numbers).unflatten(1, (4, 4))
    turn = roma.rotvec_to_rotmat(
        share[:, None].to(motion) * roma.rotmat_to_rotvec(motion[before, :3, :3].mT @ motion[after, :3, :3])
    )
    result[:, :3, :3] = torch.where(known[:, None, None], motion[:, :3, :3], motion[before, :3, :3] @ turn)
    return result


def _neighbours(known: Tensor, numbers: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """For each frame the known ones before and after it, and how far it is on the way, in [0, 1]."""
    frames = torch.arange(len(known))
    last = torch.where(known, frames, -1).cummax(dim=0).values
    next_one = torch.where(known, frames, len(known)).flip(0).cummin(dim=0).values.flip(0)
    before = torch.where(last < 0, next_one, last)
    after = torch.where(next_one == len(known), last, next_one)
    apart = (numbers[after] - numbers[before]).clamp_min(1)
    return before, after, (numbers - numbers[before]).double() / apart


SETTLED_MM = 0.01  # on average, that another turn still moves a frame's vertices by
LEAST_KNOWN = 0.02  # of the vertices, for a frame to be solved
FEWEST_KNOWN = 3


@dataclass
class Found:
    """What was found for a window.

    Attributes:
        controls: `(frame, control)`; neutral where the frame is unknown.
        motion: `(frame, 4, 4)`: from the rig's mesh to the world; None where none was looked for.
        still: the meshes without it, `(frame, vertex, 3)`; NaN where a vertex is not known.
        complete: the same, with the rig's own mesh where a vertex is not known.
        results: what the rig makes of the controls, `(frame, vertex, 3)`.
        present: whether enough of a frame is known to solve it, `(frame,)`.
    """

    controls: Tensor
    motion: Tensor | None
    still: Tensor
    complete: Tensor
    results: Tensor
    present: Tensor


class WindowInverter:
    """Inverts windows of a clip.

    Args:
        rig: whose meshes the solving fits.
        solving: from complete meshes to controls.
        anchors: what rigid motion is told by; None: it is left in.
        weights: how much of each vertex is to be believed, `(vertex,)` in [0, 1], where the solving itself does not weigh them.
        turns: at most.
    """

    def __init__(
        self, rig: LinearRig, solving: ControlEstimator, anchors: Anchors | None, weights: Tensor | None, turns: int
    ) -> None:
        self.rig, self.solving, self.anchors, self.weights, self.turns = rig, solving, anchors, weights, turns

    @torch.no_grad()
    def invert(self, vertices: Tensor) -> Found:
        """Meshes `(frame, vertex, 3)`, mm; NaN where a vertex is not known."""
        known = torch.isfinite(vertices).all(dim=2)
        present = (known.float().mean(dim=1) >= LEAST_KNOWN) & (known.sum(dim=1) >= FEWEST_KNOWN)
        controls = self.rig.neutral_controls.expand(len(vertices), -1).clone()
        motion = None if self.anchors is None else torch.eye(4).expand(len(vertices), -1, -1).clone()
        rows = present.nonzero()[:, 0]
        if len(rows):
            whole = bool(known[rows].all()) and self.weights is None
            turns = _AlternatingSolve(self, vertices[rows], known[rows], whole)
            controls[rows] = turns.take()
            if motion is not None:
                motion[rows] = turns.motion
        return self.placed(vertices, controls, motion, present)

    @torch.no_grad()
    def placed(self, vertices: Tensor, controls: Tensor, motion: Tensor | None, present: Tensor) -> Found:
        """Meshes with the controls and the motion that were found for them."""
        still = vertices if motion is None else remove_motion(motion, vertices)
        results = self.rig(controls)
        complete = torch.where(torch.isfinite(still).all(dim=2, keepdim=True), still, results)
        return Found(controls, motion, still, complete, results, present)


class _AlternatingSolve:
    """The turns that are taken for some frames, all of which can be solved.

    Args:
        whole: whether every vertex is known and believed: then meshes are made at the anchors alone.
    """

    def __init__(self, inverter: WindowInverter, vertices: Tensor, known: Tensor, whole: bool) -> None:
        self.inverter, self.vertices, self.known, self.whole = inverter, vertices, known, whole
        rig, self.anchors = inverter.rig, inverter.anchors and inverter.anchors.for_window(known)
        self.controls = rig.neutral_controls.expand(len(vertices), -1).clone()
        self.results = None if whole else rig.rest_vertices.expand_as(vertices).clone()
        self.motion = None
        if self.anchors is not None:
            self.at_anchors = self.anchors.rest.expand(len(vertices), -1, -1).clone()
            self.motion = fit_rigid(self.at_anchors, vertices[:, self.anchors.some], self.anchors.weights)

    def take(self) -> Tensor:
        """All turns; the controls `(frame, control)`."""
        rows = torch.arange(len(self.vertices))
        only_once = self.whole and self.anchors is None
        for turn in range(1 if only_once else self.inverter.turns):
            rows = rows[self._turn(rows, turn)] if len(rows) else rows
        return self.controls

    def _turn(self, rows: Tensor, turn: int) -> Tensor:
        """One turn for some frames; whether each is to have another."""
        target = self.vertices[rows]
        still = target if self.motion is None else remove_motion(self.motion[rows], target)
        solving, weights = self.inverter.solving, self.inverter.weights
        if not self.whole:
            still = torch.where(self.known[rows][..., None], still, self.results[rows])
        if weights is not None:
            still = self.results[rows] + weights[:, None] * (still - self.results[rows])
        self.controls[rows] = solving.again(still, self.controls[rows]) if turn else solving.first(still)
        change = self._make_meshes(rows)
        return change.norm(dim=2).mean(dim=1) > SETTLED_MM

    def _make_meshes(self, rows: Tensor) -> Tensor:
        """Make the meshes of controls that have just been found, and fit the motion to them; how far vertices went."""
        controls, results = self.controls[rows], None
        change = torch.zeros(len(rows), 1, 3)
        if not self.whole:
            results = self.inverter.rig(controls)
            change = results - self.results[rows]
            self.results[rows] = results
        if self.anchors is not None:
            anchors = self.anchors
            now = anchors.mesh(controls) if results is None else results[:, anchors.some]
            before = apply_motion(self.motion[rows], self.at_anchors[rows])
            motion = fit_rigid(now, self.vertices[rows][:, anchors.some], anchors.weights, self.motion[rows])
            self.motion[rows], self.at_anchors[rows] = motion, now
            change = apply_motion(motion, now) - before
        return change
