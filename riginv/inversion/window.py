"""One window of a clip: rigid motion, missing vertices and controls, each found by the others, in turns.

The controls tell where unseen vertices are, and how far the face has moved in itself; the rest is rigid motion. Taking turns
minimises the distance of the vertices that were seen, over controls and motion together.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.inversion.rigid import fit_rigid, moved, unmoved
from riginv.inversion.solving import Solving
from riginv.rig import RigBackend

SETTLED_MM = 0.01  # on average, that another turn still moves a frame's vertices by
FEWEST = 0.02  # of the vertices that must be known, for a frame to be solved


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
        stillness: how much each vertex counts for rigid motion, `(vertex,)`; None: rigid motion is left in.
        weights: how much of each vertex is to be believed, `(vertex,)` in [0, 1], where the solving itself does not weigh them.
        turns: at most.
    """

    def __init__(self, rig: RigBackend, solving: Solving, stillness: Tensor | None, weights: Tensor | None, turns: int) -> None:
        self.rig, self.solving, self.stillness, self.weights, self.turns = rig, solving, stillness, weights, turns

    @torch.no_grad()
    def invert(self, vertices: Tensor) -> Found:
        """Meshes `(frame, vertex, 3)`, mm; NaN where a vertex is not known."""
        known = torch.isfinite(vertices).all(dim=2)
        present = known.float().mean(dim=1) >= FEWEST
        present &= known.sum(dim=1) >= 3
        count, rest = len(vertices), self.rig.rest_vertices
        found = Found(
            self.rig.neutral_controls.expand(count, -1).clone(),
            None if self.stillness is None else torch.eye(4).expand(count, -1, -1).clone(),
            vertices,
            torch.where(known[..., None], vertices, rest),
            rest.expand(count, -1, -1).clone(),
            present,
        )
        rows = present.nonzero()[:, 0]
        if self.stillness is None and self.weights is None and bool(known.all()):
            found.controls = self.solving.first(vertices)
            found.results = self.rig(found.controls)
            return found
        if self.stillness is not None:
            found.still = vertices.clone()
            found.motion[rows] = fit_rigid(rest[None], vertices[rows], self.stillness)
        for turn in range(self.turns):
            if not len(rows):
                break
            rows = self._turn(found, vertices, known, rows, turn)
        return found

    def _turn(self, found: Found, vertices: Tensor, known: Tensor, rows: Tensor, turn: int) -> Tensor:
        """One turn for some frames; those that are not settled after it."""
        target, before = vertices[rows], found.results[rows]
        still = target if found.motion is None else unmoved(found.motion[rows], target)
        complete = torch.where(known[rows][..., None], still, before)
        if self.weights is not None:
            complete = before + self.weights[:, None] * (complete - before)
        found.controls[rows] = self.solving.first(complete) if turn == 0 else self.solving.again(complete, found.controls[rows])
        results = self.rig(found.controls[rows])
        change = results - before
        if found.motion is not None:
            motion = fit_rigid(results, target, self.stillness)
            change = moved(motion, results) - moved(found.motion[rows], before)
            found.motion[rows] = motion
            still = unmoved(motion, target)
        found.results[rows], found.still[rows] = results, still
        found.complete[rows] = torch.where(known[rows][..., None], still, results)
        return rows[change.norm(dim=2).mean(dim=1) > SETTLED_MM]
