"""Whether a clip moves as a whole, beyond what its own noise could be: rigid motion that is not there is not taken out.

A rigid motion can always be fitted, and takes up some of what the rig cannot make. So some frames are solved twice, with rigid
motion taken out and left in: where it is real, what remains falls by far more than six numbers a frame would make it fall.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig
from riginv.tracking.alternation import FEWEST_KNOWN, Found, WindowInverter
from riginv.tracking.anchors import Anchors
from riginv.tracking.estimators import ControlEstimator
from riginv.tracking.rigid import apply_motion, fit_rigid

PROBED, SOLVED, FARTHEST = 128, 12, 4  # frames that are looked at, that are solved, and of these the ones that moved farthest
OBVIOUS = 0.02  # of the mesh's size, that half of the frames went: no need to solve
GAIN = 0.1  # by which the squared error falls in half of the frames, as a share of what remains, for motion to be real
FRAME_GAIN, FRAME_GAIN_MM = 0.5, 0.05  # the same of a single frame, and what that must be in root mean square distance
LEAST_GAIN_MM = 0.02  # root mean square distance: below it nothing matters
FRAMES = 1 / 8  # of those solved, that may move so for the clip to do


@dataclass(frozen=True)
class RigidCheck:
    """What was found of a clip.

    Attributes:
        moves: whether it moves as a whole.
        extent_mm: how far the motion that fits best goes, the mean over vertices of the frame where it goes farthest.
        residual_mm: the root mean square distance that remains where rigid motion is left in; NaN where nothing was solved.
    """

    moves: bool
    extent_mm: float
    residual_mm: float = float("nan")

    @property
    def note(self) -> str:
        """What the user should know where it does not move."""
        return (
            f"no rigid motion found: with it left in {self.residual_mm:.2g} mm remain (root mean square), of which the best "
            f"fit, {self.extent_mm:.2g} mm at most, explains next to nothing (motion=remove takes it out all the same)"
        )


@torch.no_grad()
def check_rigid(
    clip: Clip, rig: LinearRig, solving: ControlEstimator, anchors: Anchors, weights: Tensor | None, turns: int
) -> RigidCheck:
    """Whether a clip moves as a whole.

    Args:
        clip: NaN where a vertex is not known.
        weights: how much each vertex counts, `(vertex,)`; None: all alike.
        turns: as in `WindowInverter`.
    """
    rows = evenly(PROBED, len(clip))
    extents = torch.cat([_extent(clip.vertices(row, row + 1), anchors) for row in rows.tolist()])
    known = extents.isfinite()
    if not bool(known.any()):
        return RigidCheck(False, 0.0)
    rows, extents = rows[known], extents[known]
    size = (rig.rest_vertices - rig.rest_vertices.mean(dim=0)).norm(dim=1).mean()
    if float(extents.median()) > OBVIOUS * float(size):
        return RigidCheck(True, float(extents.max()))
    farthest = extents.argsort(descending=True)[:FARTHEST]
    chosen = torch.cat([evenly(SOLVED, len(rows)), farthest]).unique()
    vertices = torch.cat([clip.vertices(row, row + 1) for row in rows[chosen].tolist()])
    inverter = WindowInverter(rig, solving, None, None, turns)
    without, left_in = WindowInverter(rig, solving, anchors, None, turns).invert(vertices), inverter.invert(vertices)
    again = inverter.placed(vertices, solving.again(left_in.complete, without.controls), None, without.present)
    remaining, kept, same_start = (_squares(found, weights) for found in (without, left_in, again))
    kept = torch.minimum(kept, same_start)  # what another start would have found is no rigid motion
    gain = kept - remaining
    moving = (gain > FRAME_GAIN * remaining) & (gain > FRAME_GAIN_MM**2)
    half = (gain > GAIN * remaining).float().mean() > 0.5 and gain.median() > LEAST_GAIN_MM**2
    rest = anchors.rest.expand(len(chosen), -1, -1)
    extent = (apply_motion(without.motion, rest) - rest).norm(dim=2).mean(dim=1).max()
    return RigidCheck(bool(half or moving.float().mean() >= FRAMES), float(extent), float(kept.mean().clamp_min(0).sqrt()))


def anchors_if_moving(
    clip: Clip,
    rig: LinearRig,
    solving: ControlEstimator,
    anchors: Anchors,
    weights: Tensor | None,
    turns: int,
    notes: list[str],
) -> Anchors | None:
    """The anchors where a clip moves as a whole; None, and a note, where it does not."""
    if clip.sequence.in_rig_space:
        notes.append("no rigid motion was looked for: the meshes were made from the rig's own (motion=remove does so)")
        return None
    check = check_rigid(clip, rig, solving, anchors, weights, turns)
    if check.moves:
        return anchors
    notes.append(check.note)
    return None


def _extent(vertices: Tensor, anchors: Anchors) -> Tensor:
    """How far the motion goes that fits the rest mesh best to a mesh `(1, vertex, 3)`, mm; NaN where too little is known."""
    target = vertices[:, anchors.some]
    enough = (torch.isfinite(target).all(dim=2) & (anchors.weights > 0)).sum(dim=1) >= FEWEST_KNOWN
    motion = fit_rigid(anchors.rest[None], target, anchors.weights)
    distance = (apply_motion(motion, anchors.rest[None]) - anchors.rest).norm(dim=2).mean(dim=1)
    return torch.where(enough, distance, torch.nan)


def _squares(found: Found, weights: Tensor | None) -> Tensor:
    """The mean squared distance `(frame,)`, mm^2, of the vertices that are known."""
    squares = (found.results - found.still).square().sum(dim=2)
    counts = torch.isfinite(squares).to(squares) * (1.0 if weights is None else weights)
    return (squares.nan_to_num(0.0) * counts).sum(dim=1) / counts.sum(dim=1).clamp_min(1e-9)
