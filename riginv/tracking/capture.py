"""A clip to judge inverses on: in the rig's own space, whole, and with what is not known kept apart.

Methods that are judged get meshes without rigid motion, in which the rig's own mesh stands in for vertices that are not known;
errors are measured at the others alone.
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
from riginv.evaluation.optimum import fingerprint
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.cache import cached_tensors, code_key
from riginv.solvers.objective import PRIOR, Objective
from riginv.tracking.alternation import WindowInverter
from riginv.tracking.anchors import Anchors
from riginv.tracking.estimators import SolverEstimator
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.rigid import remove_motion
from riginv.tracking.rigid_check import anchors_if_moving
from riginv.tracking.stability import has_root_controls, stability_weights

NAME = "capture"  # of the set
WINDOW = 128  # frames at a time
STEPS, TURNS = 30, 12  # as `riginv.invert` takes


class CapturedMeshes(MeshSet):
    """The frames of a clip that are known, without rigid motion and without holes.

    Args:
        clip: as it was read.
        rig: whose mesh stands in for vertices that are not known.
        rows: the frames of the clip that are known, `(frame,)`.
        motion: the rigid motion of all frames of the clip, `(frame, 4, 4)`; None: it has none.
        filling: controls of all frames of the clip, `(frame, control)`, that make what stands in; None: it has no holes.
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
        meshes = self._given(rows)
        if self.filling is None:
            return meshes
        known = torch.isfinite(meshes).all(dim=2)
        gone = (~known.all(dim=1)).nonzero()[:, 0]
        if len(gone):
            meshes[gone] = torch.where(known[gone][..., None], meshes[gone], self.rig(self.filling[rows[gone]]).to(meshes))
        return meshes

    def known(self, start: int, stop: int) -> Tensor | None:
        return None if self.filling is None else torch.isfinite(self._given(self.rows[start:stop])).all(dim=2)

    def _given(self, rows: Tensor) -> Tensor:
        """Frames as they were read, without rigid motion; rows that follow one another are read together."""
        cuts = ((rows.diff() != 1).nonzero()[:, 0] + 1).tolist()
        spans = [(rows[first], rows[last - 1] + 1) for first, last in zip([0, *cuts], [*cuts, len(rows)]) if last > first]
        meshes = [self.clip.vertices(int(first), int(stop)) for first, stop in spans]
        found = torch.cat(meshes) if meshes else self.rig.rest_vertices.new_zeros(0, *self.rig.rest_vertices.shape)
        return found if self.motion is None else remove_motion(self.motion[rows].to(found), found)


def open_capture(
    path: str, true_rig: RigBackend, rig: LinearRig, reading: ReadingOptions, frames: FrameOptions
) -> CapturedMeshes:
    """A clip to judge on, from any file that `riginv.invert` takes.

    Rigid motion is found as there, once, and kept in the cache.

    Args:
        true_rig: whose clip it is.
        rig: what is solved through to find rigid motion, and what stands in for unknown vertices.

    Raises:
        InputError: it cannot be read, is no clip of the rig, or no frame of it is known.
    """
    clip, notes = open_clip(str(path), true_rig, reading, frames)
    every = torch.arange(len(clip))
    if clip.sequence.in_rig_space and not bool(clip.excluded.any()):
        return CapturedMeshes(clip, rig, every, None, None, tuple(notes))
    digest, holes = _looked_through(clip)
    here = Path(__file__).parent
    key = hashlib.sha256(fingerprint(rig) + code_key([here]).encode() + digest).hexdigest()[:32]
    found = cached_tensors("capture", key, lambda: _prepared(clip, rig, true_rig, holes))
    known = found["present"]
    if not bool(known.any()):
        raise InputError(f"{path}: no frame has enough known vertices: there is nothing to judge on")
    motion, filling = (found[name] if len(found[name]) else None for name in ("motion", "filling"))
    if motion is not None:
        notes.append("rigid motion was taken out, as riginv.invert does")
    if filling is not None:
        notes.append("vertices that are not known count for no error; the rig's own mesh stands in for them")
    if not bool(known.all()):
        notes.append(f"frames of which too little is known were left out: {int((~known).sum()):,} of {len(clip):,}")
    return CapturedMeshes(clip, rig, every[known], motion, filling, tuple(notes))


def content_key(meshes: MeshSet) -> str:
    """A key of all meshes of a set, and of when they are."""
    digest = hashlib.sha256(f"{meshes.fps} {meshes.frame_numbers}".encode())
    for _, vertices in meshes.batches(WINDOW):
        digest.update(vertices.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _looked_through(clip: Clip) -> tuple[bytes, Tensor]:
    """A key of what a clip holds, and which of its frames have holes, `(frame,)`."""
    digest, holes = hashlib.sha256(), []
    for _, vertices in clip.batches(WINDOW):
        digest.update(vertices.numpy().tobytes())
        holes.append(~torch.isfinite(vertices).all(dim=2).all(dim=1))
    return digest.digest(), torch.cat(holes)


@torch.no_grad()
def _prepared(clip: Clip, rig: LinearRig, true_rig: RigBackend, holes: Tensor) -> dict[str, Tensor]:
    """The rigid motion and the controls of all frames, and whether each is known; empty where there is no need for them."""
    space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    held = FixedControlsRig(rig, torch.arange(len(rig.controls)), rig.neutral_controls)
    solving = SolverEstimator(Objective(RigInMeshSpace(held, space.space), PRIOR), None, STEPS, 1, 0)
    anchors = None
    if not clip.sequence.in_rig_space and not has_root_controls(space):
        anchors = Anchors(rig, stability_weights(true_rig))
        anchors = anchors_if_moving(clip, rig, solving, anchors, None, TURNS, [])
    inverter = WindowInverter(rig, solving, anchors, None, TURNS)
    controls = rig.neutral_controls.repeat(len(clip), 1)
    motion = torch.eye(4).repeat(len(clip), 1, 1)
    present = torch.ones(len(clip), dtype=torch.bool)
    starts = [start for start in range(0, len(clip), WINDOW) if anchors is not None or holes[start : start + WINDOW].any()]
    console = Console(stderr=True)
    for start in track(starts, "rigid motion and unknown vertices", console=console, transient=True, disable=not starts):
        rows = slice(start, min(start + WINDOW, len(clip)))
        found = inverter.invert(clip.vertices(rows.start, rows.stop))
        controls[rows], present[rows] = found.controls, found.present
        if found.motion is not None:
            motion[rows] = found.motion
    none = torch.zeros(0)
    return {
        "motion": none if anchors is None else motion,
        "filling": controls if bool(holes[present].any()) else none,
        "present": present,
    }
