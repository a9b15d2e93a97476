"""A captured clip as an evaluation set: without rigid motion, with unknown vertices filled by the rig.

Errors are measured at known vertices alone.
"""

import hashlib
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.clips.open import open_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.errors import InputError
from riginv.evaluation.optimum import rig_digest
from riginv.geometry.kinematics import remove_motion
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.cache import cached_tensors, code_key
from riginv.solvers.objective import PRIOR, Objective
from riginv.tracking.alternation import WindowInverter
from riginv.tracking.anchors import Anchors
from riginv.tracking.estimators import SolverEstimator
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.options import SolverOptions, TrackingOptions
from riginv.tracking.rigid_check import anchors_if_moving
from riginv.tracking.stability import has_root_controls, stability_weights

NAME = "capture"  # of the set
WINDOW = 128  # frames at a time


class CapturedMeshes(MeshSet):
    """The solvable frames of a clip, without rigid motion and with unknown vertices filled.

    Args:
        clip: as read.
        rig: its mesh fills in unknown vertices.
        rows: indices of the solvable frames, `(frame,)`.
        motion: rigid motion of all frames of the clip, `(frame, 4, 4)`; None: it has none.
        filling: controls of all frames of the clip, `(frame, control)`, for filling; None: all vertices are known.
        notes: what was guessed, found or left out.
    """

    def __init__(
        self,
        clip: Clip,
        rig: RigBackend,
        rows: Tensor,
        motion: Tensor | None,
        filling: Tensor | None,
        notes: tuple[str, ...],
    ) -> None:
        controls = None if clip.controls is None else clip.controls[rows]
        super().__init__(NAME, clip.fps, controls, clip.frame_numbers[rows])
        self.clip, self.rig, self.rows, self.motion, self.filling, self.notes = clip, rig, rows, motion, filling, notes

    def __len__(self) -> int:
        return len(self.rows)

    @torch.no_grad()
    def vertices(self, start: int, stop: int) -> Tensor:
        rows = self.rows[start:stop]
        meshes = self._stabilised(rows)
        if self.filling is None:
            return meshes
        known = torch.isfinite(meshes).all(dim=2)
        gone = (~known.all(dim=1)).nonzero()[:, 0]
        if len(gone):
            meshes[gone] = torch.where(known[gone][..., None], meshes[gone], self.rig(self.filling[rows[gone]]).to(meshes))
        return meshes

    def known(self, start: int, stop: int) -> Tensor | None:
        return None if self.filling is None else torch.isfinite(self._stabilised(self.rows[start:stop])).all(dim=2)

    def _stabilised(self, rows: Tensor) -> Tensor:
        """Frames without rigid motion, as read; consecutive rows are read together."""
        cuts = ((rows.diff() != 1).nonzero()[:, 0] + 1).tolist()
        spans = [(rows[first], rows[last - 1] + 1) for first, last in zip([0, *cuts], [*cuts, len(rows)]) if last > first]
        meshes = [self.clip.vertices(int(first), int(stop)) for first, stop in spans]
        found = torch.cat(meshes) if meshes else self.rig.rest_vertices.new_zeros(0, *self.rig.rest_vertices.shape)
        return found if self.motion is None else remove_motion(self.motion[rows].to(found), found)


def open_capture(
    path: str, true_rig: RigBackend, rig: LinearRig, reading: ReadingOptions, frames: FrameOptions
) -> CapturedMeshes:
    """An evaluation set from any file that `riginv.invert` takes; its rigid motion is estimated once and cached.

    Args:
        true_rig: the rig of the clip.
        rig: to solve for rigid motion and unknown vertices.

    Raises:
        InputError: it cannot be read, is no clip of the rig, or no frame of it is known.
    """
    clip, notes = open_clip(str(path), true_rig, reading, frames)
    every = torch.arange(len(clip))
    if clip.sequence.in_rig_space and not bool(clip.excluded.any()):
        return CapturedMeshes(clip, rig, every, None, None, tuple(notes))
    digest, has_unknown = _digest(clip)
    here = Path(__file__).parent
    key = hashlib.sha256(rig_digest(rig) + code_key([here]).encode() + digest).hexdigest()[:32]
    prepared = cached_tensors("capture", key, lambda: _prepared(clip, rig, true_rig, has_unknown))
    solvable = prepared["solvable"]
    if not bool(solvable.any()):
        raise InputError(f"{path}: no frame has enough known vertices: there is nothing to evaluate on")
    motion, filling = (prepared[name] if len(prepared[name]) else None for name in ("motion", "filling"))
    if motion is not None:
        notes.append("rigid motion was removed, as riginv.invert does")
    if filling is not None:
        notes.append("vertices that are not known count for no error; the rig's own mesh fills them in")
    if not bool(solvable.all()):
        notes.append(f"frames of which too little is known were left out: {int((~solvable).sum()):,} of {len(clip):,}")
    return CapturedMeshes(clip, rig, every[solvable], motion, filling, tuple(notes))


def content_key(meshes: MeshSet) -> str:
    """A digest of all meshes of a set and their times."""
    digest = hashlib.sha256(f"{meshes.fps} {meshes.frame_numbers}".encode())
    for _, vertices in meshes.batches(WINDOW):
        digest.update(vertices.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _digest(clip: Clip) -> tuple[bytes, Tensor]:
    """A digest of a clip's meshes, and whether each frame has unknown vertices, `(frame,)`."""
    digest, has_unknown = hashlib.sha256(), []
    for _, vertices in clip.batches(WINDOW):
        digest.update(vertices.numpy().tobytes())
        has_unknown.append(~torch.isfinite(vertices).all(dim=2).all(dim=1))
    return digest.digest(), torch.cat(has_unknown)


@torch.no_grad()
def _prepared(clip: Clip, rig: LinearRig, true_rig: RigBackend, has_unknown: Tensor) -> dict[str, Tensor]:
    """Rigid motion and controls of all frames, empty where not needed, and whether each frame is solvable."""
    space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    fixed = FixedControlsRig(rig, torch.arange(len(rig.controls)), rig.neutral_controls)
    estimator = SolverEstimator(Objective(RigInMeshSpace(fixed, space.space), PRIOR), None, SolverOptions.steps, 1, 0)
    anchors = None
    if not clip.sequence.in_rig_space and not has_root_controls(space):
        anchors = Anchors(rig, stability_weights(true_rig))
        anchors = anchors_if_moving(clip, rig, estimator, anchors, None, TrackingOptions.iterations, [])
    inverter = WindowInverter(rig, estimator, anchors, None, TrackingOptions.iterations)
    controls = rig.neutral_controls.repeat(len(clip), 1)
    motion = torch.eye(4).repeat(len(clip), 1, 1)
    solvable = torch.ones(len(clip), dtype=torch.bool)
    windows = range(0, len(clip), WINDOW)
    starts = [start for start in windows if anchors is not None or has_unknown[start : start + WINDOW].any()]
    console = Console(stderr=True)
    for start in track(starts, "rigid motion and unknown vertices", console=console, transient=True, disable=not starts):
        rows = slice(start, min(start + WINDOW, len(clip)))
        result = inverter.invert(clip.vertices(rows.start, rows.stop))
        controls[rows], solvable[rows] = result.controls, result.solvable
        if result.motion is not None:
            motion[rows] = result.motion
    none = torch.zeros(0)
    return {
        "motion": none if anchors is None else motion,
        "filling": controls if bool(has_unknown[solvable].any()) else none,
        "solvable": solvable,
    }
