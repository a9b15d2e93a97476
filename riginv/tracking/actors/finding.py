"""The actor of a clip: its neutral as given, or found together with the controls of frames spread over the clip."""

import functools
from dataclasses import replace

import torch
from torch import Tensor

from riginv.clips.clip import Clip
from riginv.clips.options import ReadingOptions
from riginv.errors import InputError, counted
from riginv.geometry.kinematics import remove_motion
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.console import show_lines
from riginv.solvers.offset import OffsetSolver
from riginv.tracking.actors.actor import Actor, ActorRig, solved_notes
from riginv.tracking.actors.neutral import GivenNeutral, in_rig_space, neutral_of_frames, read_neutral
from riginv.tracking.alternation import MIN_KNOWN
from riginv.tracking.assembly import build_solver
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.options import SOLVE, TrackingOptions
from riginv.tracking.regions import vertex_weights
from riginv.tracking.rigid import fit_rigid
from riginv.tracking.stability import has_root_controls, stability_weights
from riginv.tracking.static_controls import spread_frames

SPARSITY = 3e-5  # mm^2, an L1 penalty, without which the neutral pose would be ambiguous (docs/experiments.md#actors)
LEAST_SPARSITY, EXACT_MM = 1e-6, 0.02  # for frames that the rig makes within EXACT_MM, root mean square
FRAMES, FRAMES_TO_ALIGN = 60, 16  # frames spread over the clip, to solve for an offset, and for a rotation alone
STEPS, STEPS_TO_ALIGN = 40, 12


@torch.no_grad()
def find_actor(
    options: TrackingOptions, reading: ReadingOptions, clip: Clip, rig: LinearRig, true_rig: RigBackend
) -> Actor | None:
    """The actor of a clip; None where the options name none.

    Raises:
        InputError: the neutral cannot be read or does not fit the rig, or the clip has no known frames.
    """
    given = options.actor
    if not given.is_given:
        return None
    if clip.sequence.in_rig_space:
        raise InputError(f"actor.* is for captured meshes, and {clip.sequence.path} holds curves of the rig: leave it out")
    moves = options.motion == "remove" or (
        options.motion == "auto" and not has_root_controls(RigInMeshSpace(rig, MeshSpace.from_rig(rig)))
    )
    finder = _Finder(options, clip, rig, true_rig, moves)
    if given.neutral == SOLVE:
        return finder.solved()
    if given.neutral:
        neutral = read_neutral(given, true_rig, reading)
    else:
        neutral = neutral_of_frames(clip, list(given.neutral_frames), finder.stability)
    return finder.aligned(neutral)


class _Finder:
    """Finds an actor's neutral in the rig's space.

    Args:
        moves: whether the clip may have rigid motion, which then the neutral has, too.
    """

    def __init__(self, options: TrackingOptions, clip: Clip, rig: LinearRig, true_rig: RigBackend, moves: bool) -> None:
        self.options, self.clip, self.rig, self.moves = options, clip, rig, moves
        self.stability, self.rest = stability_weights(true_rig), rig.rest_vertices
        weights = vertex_weights(true_rig, options.vertices)
        self.counts = torch.ones(len(self.rest), dtype=torch.bool) if weights is None else weights > 0

    def solved(self) -> Actor:
        """The neutral that fits the whole clip best with the sparsest controls."""
        frames = self._frames(FRAMES, self.rest)
        known = torch.isfinite(frames).all(dim=2, keepdim=True)
        mean = torch.where(known, frames, 0.0).sum(dim=0) / known.sum(dim=0).clamp_min(1)
        start = torch.where(known.any(dim=0), mean, self.rest)
        show_lines([], [f"the actor's neutral is solved for with {counted(len(frames), 'frame')} spread over the clip"])
        solver = self._solver(SPARSITY)
        found = solver.solve(frames, start, STEPS)
        steps = found.steps
        if solver.residual_mm(found) < EXACT_MM:  # the penalty would hide what the rig's logic tells of the neutral
            moved = torch.where(known, found.vertices, torch.nan)
            found = self._solver(LEAST_SPARSITY).solve(moved, found.neutral, STEPS, found.units)
            steps += found.steps
        notes = solved_notes(steps, len(frames))
        if not bool(known.any(dim=0).all()):
            notes.append(f"{int((~known.any(dim=0)).sum()):,} vertices are never known: the actor has the rig's there")
        return self._actor(found.neutral, SOLVE, notes, {"frames": len(frames), "steps": steps})

    def aligned(self, given: GivenNeutral) -> Actor:
        """A given neutral, rotated so that the rig's displacements lie right on it."""
        neutral = in_rig_space(given, self.rest, self.stability * self.counts, self.moves)
        if not self.moves:
            return self._actor(neutral, given.source, given.notes, {})
        found = self._solver(None).solve(self._frames(FRAMES_TO_ALIGN, neutral), neutral, STEPS_TO_ALIGN)
        return self._actor(found.neutral, given.source, given.notes, {})

    def _actor(self, neutral: Tensor, source: str, notes: list[str], facts: dict) -> Actor:
        if self.moves:  # rigid motion makes any translation: the one that is nearest to the rig is taken
            neutral = neutral - (neutral - self.rest).mean(dim=0)
        return Actor(neutral, neutral - self.rest, self.options.actor.scale, source, tuple(notes), facts)

    def _solver(self, least_sparsity: float | None) -> OffsetSolver:
        """With at least this sparsity for an unknown neutral; None: the neutral is given."""
        sparsity = max(self.options.solver.sparsity, least_sparsity or 0.0)
        options = replace(self.options, solver=replace(self.options.solver, sparsity=sparsity))
        constraints = resolve_constraints(self.rig, options.controls)
        solver = build_solver(options, self.in_space, constraints, None, None, "levenberg_marquardt", self.rig)
        return OffsetSolver(solver.objective, self.moves, least_sparsity is not None)

    @functools.cached_property
    def in_space(self) -> RigInMeshSpace:
        """The rig, with the actor's scale, in its mesh space."""
        scale = self.options.actor.scale
        rig = self.rig if scale == 1 else ActorRig(self.rig, Actor(self.rest, torch.zeros_like(self.rest), scale, ""))
        return RigInMeshSpace(rig, MeshSpace.from_rig(rig))

    def _frames(self, count: int, neutral: Tensor) -> Tensor:
        """Frames spread over the clip, moved to a neutral, without vertices that do not count."""
        frames = spread_frames(self.clip, count).to(self.rest)
        frames[:, ~self.counts] = torch.nan
        frames = frames[torch.isfinite(frames).all(dim=2).float().mean(dim=1) >= MIN_KNOWN]
        if not len(frames):
            raise InputError(f"{self.clip.sequence.path}: no frame has enough known vertices: the actor cannot be found")
        return self._to(frames, neutral) if self.moves else frames

    def _to(self, frames: Tensor, neutral: Tensor) -> Tensor:
        return remove_motion(fit_rigid(neutral[None], frames, self.stability * self.counts), frames)
