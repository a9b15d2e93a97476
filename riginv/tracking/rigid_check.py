"""A test for rigid motion in a clip, so that only real rigid motion is removed.

A rigid motion can always be fitted and explains some of what the rig cannot make. So some frames are solved with rigid motion
removed and kept: where it is real, the residual falls by far more than six further parameters per frame explain.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.geometry.kinematics import apply_motion
from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig
from riginv.tracking.alternation import MIN_KNOWN_VERTICES, WindowInverter, WindowResult
from riginv.tracking.anchors import Anchors
from riginv.tracking.estimators import ControlEstimator
from riginv.tracking.rigid import fit_rigid

PROBED, SOLVED, FARTHEST = 128, 12, 4  # frames that are fitted, that are solved, and that moved farthest among these
OBVIOUS = 0.02  # median motion, relative to the mesh size, that needs no solving
GAIN = 0.1  # median decrease of the squared error, relative to the residual, for real motion
FRAME_GAIN, FRAME_GAIN_MM = 0.5, 0.05  # the same for a single frame, and its least root mean square distance
MIN_GAIN_MM = 0.02  # least root mean square distance that matters
FRAMES = 1 / 8  # fraction of the solved frames with real motion for the clip to have it


@dataclass(frozen=True)
class RigidCheck:
    """The result of the test.

    Attributes:
        moves: whether the clip has rigid motion.
        extent_mm: mean vertex displacement by the best rigid motion, in the frame where it is largest.
        residual_mm: root mean square distance with rigid motion kept; NaN where nothing was solved.
    """

    moves: bool
    extent_mm: float
    residual_mm: float = float("nan")

    @property
    def note(self) -> str:
        """A note for the user where there is no rigid motion."""
        return (
            f"no rigid motion found: removing the best fit, of {self.extent_mm:.2g} mm at most, hardly lowers the error of "
            f"{self.residual_mm:.2g} mm (root mean square); motion=remove removes it in any case"
        )


@torch.no_grad()
def check_rigid(
    clip: Clip, rig: LinearRig, estimator: ControlEstimator, anchors: Anchors, weights: Tensor | None, iterations: int
) -> RigidCheck:
    """Test a clip for rigid motion.

    Args:
        clip: NaN where a vertex is not known.
        weights: of the vertices, `(vertex,)`; None: equal.
        iterations: as in `WindowInverter`.
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
    inverter = WindowInverter(rig, estimator, None, None, iterations)
    without, with_motion = WindowInverter(rig, estimator, anchors, None, iterations).invert(vertices), inverter.invert(vertices)
    refined = estimator.refine(with_motion.filled, without.controls)
    restarted = inverter.result(vertices, refined, None, without.solvable)
    remaining, kept, same_start = (_squares(found, weights) for found in (without, with_motion, restarted))
    kept = torch.minimum(kept, same_start)  # a gain from another start is no rigid motion
    gain = kept - remaining
    moving = (gain > FRAME_GAIN * remaining) & (gain > FRAME_GAIN_MM**2)
    half = (gain > GAIN * remaining).float().mean() > 0.5 and gain.median() > MIN_GAIN_MM**2
    rest = anchors.rest.expand(len(chosen), -1, -1)
    assert without.motion is not None
    extent = (apply_motion(without.motion, rest) - rest).norm(dim=2).mean(dim=1).max()
    return RigidCheck(bool(half or moving.float().mean() >= FRAMES), float(extent), float(kept.mean().clamp_min(0).sqrt()))


def anchors_if_moving(
    clip: Clip,
    rig: LinearRig,
    estimator: ControlEstimator,
    anchors: Anchors,
    weights: Tensor | None,
    iterations: int,
    notes: list[str],
) -> Anchors | None:
    """The anchors where a clip has rigid motion; None, and a note, where it has none."""
    if clip.sequence.in_rig_space:
        notes.append("rigid motion was not searched for: the clip was made by the rig (motion=remove searches for it)")
        return None
    check = check_rigid(clip, rig, estimator, anchors, weights, iterations)
    if check.moves:
        return anchors
    notes.append(check.note)
    return None


def _extent(vertices: Tensor, anchors: Anchors) -> Tensor:
    """Mean displacement, mm, by the motion from the rest mesh to a mesh `(1, vertex, 3)`; NaN if too few vertices are known."""
    target = vertices[:, anchors.vertices]
    enough = (torch.isfinite(target).all(dim=2) & (anchors.weights > 0)).sum(dim=1) >= MIN_KNOWN_VERTICES
    motion = fit_rigid(anchors.rest[None], target, anchors.weights)
    distance = (apply_motion(motion, anchors.rest[None]) - anchors.rest).norm(dim=2).mean(dim=1)
    return torch.where(enough, distance, torch.nan)


def _squares(found: WindowResult, weights: Tensor | None) -> Tensor:
    """The mean squared distance of known vertices, `(frame,)`, mm^2."""
    squares = (found.recovered - found.stabilised).square().sum(dim=2)
    counts = torch.isfinite(squares).to(squares) * (1.0 if weights is None else weights)
    return (squares.nan_to_num(0.0) * counts).sum(dim=1) / counts.sum(dim=1).clamp_min(1e-9)
