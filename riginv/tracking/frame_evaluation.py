"""Every frame judged by the true rig: how far off, where, and why to look at it."""

from collections.abc import Sequence

import torch
from torch import Tensor

from riginv.animation.animation import (
    MISSING_VERTICES,
    NOT_CONVERGED,
    OUTSIDE_REACH,
    OUTSIDE_TRAINING_RANGE,
    FrameErrors,
)
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_space import MeshSpace
from riginv.tracking.alternation import Found
from riginv.tracking.estimators import ControlEstimator, NetworkEstimator
from riginv.tracking.stability import TrainingRange


class FrameEvaluator:
    """Judges windows, and keeps what it found, frame by frame.

    Args:
        frames: how many there will be.
        true_rig: who judges.
        rig: whose meshes are in what was found; where it is the true rig itself, they serve.
        space: its mesh space, unweighted.
        solving: who says whether it was done.
        training: what the network has seen; None without a network.
        believed: the vertices to judge by, `(vertex,)`; None: all.
        regions: of each vertex, by name.
        reach_mm: how far a mesh may lie from anything that the rig can make.
        range_mm: how far it may lie outside what the network has seen.
    """

    def __init__(
        self,
        frames: int,
        true_rig: RigBackend,
        rig: RigBackend,
        space: MeshSpace,
        solving: ControlEstimator,
        training: TrainingRange | None,
        believed: Tensor | None,
        regions: Sequence[str],
        reach_mm: float,
        range_mm: float,
    ) -> None:
        self.true_rig, self.rig, self.space, self.solving, self.training = true_rig, rig, space, solving, training
        self.believed, self.regions, self.reach_mm, self.range_mm = believed, regions, reach_mm, range_mm
        # Made once: small tensors that stay, between large ones that go, would leave memory full of holes.
        self.mean, self.worst = torch.full((frames,), torch.nan), torch.full((frames,), torch.nan)
        self.neutral = torch.full((frames,), torch.nan)
        self.vertex, self.flags = torch.zeros(frames, dtype=torch.long), []

    @torch.no_grad()
    def judge(self, found: Found, settled: Tensor | None = None) -> None:
        """Judge the frames of a window, in order.

        Args:
            settled: whether the solving was done with each, `(frame,)`, where it is known; else it is asked.
        """
        results = found.results if self.true_rig is self.rig else self.true_rig(found.controls)
        distance = (results - found.still).norm(dim=2)
        seen = torch.isfinite(distance)
        if self.believed is not None:
            seen &= self.believed
        distance = torch.where(seen, distance, 0.0)
        counts = seen.sum(dim=1)
        mean = torch.where(counts > 0, distance.sum(dim=1) / counts.clamp_min(1), torch.nan)
        worst, vertex = distance.max(dim=1)
        rows = slice(len(self.flags), len(self.flags) + len(mean))
        self.mean[rows], self.vertex[rows] = mean, vertex
        self.worst[rows] = torch.where(counts > 0, worst, torch.nan)
        neutral = torch.where(seen, (self.true_rig.rest_vertices - found.still).norm(dim=2), 0.0)
        self.neutral[rows] = torch.where(counts > 0, neutral.sum(dim=1) / counts.clamp_min(1), torch.nan)
        settled = self.solving.settled(found.complete, found.controls) if settled is None else settled
        self.flags += self._flags(found, mean, settled)

    def _flags(self, found: Found, mean: Tensor, settled: Tensor) -> list[list[str]]:
        complete = found.complete
        if self.believed is not None:
            complete = torch.where(self.believed[:, None], complete, found.results)
        coordinates = self.space.encode(complete)
        away = (complete - self.space.rest_vertices).square().sum(dim=(1, 2)) - coordinates.square().sum(dim=1)
        unreachable = (away.clamp_min(0) / self.space.vertex_count).sqrt() > self.reach_mm
        poor = mean > self.reach_mm
        if isinstance(self.solving, NetworkEstimator):  # what is poor may be the network's fault: a solver would tell
            settled = settled & (~poor | unreachable)
        unusual = torch.zeros_like(settled)
        if self.training is not None:
            unusual = self.training.outside_mm(coordinates) > self.range_mm
        holes = ~torch.isfinite(found.still).all(dim=2).all(dim=1)
        named = {
            OUTSIDE_TRAINING_RANGE: unusual & found.present,
            OUTSIDE_REACH: (unreachable | (poor & settled)) & found.present,
            NOT_CONVERGED: ~settled & found.present,
            MISSING_VERTICES: holes,
        }
        rows = zip(*(flagged.tolist() for flagged in named.values()))
        return [[name for name, flagged in zip(named, row) if flagged] for row in rows]

    def errors(self, frame_numbers: Tensor) -> FrameErrors:
        """What was found, frame by frame."""
        known = zip(self.vertex.tolist(), self.mean.isnan().tolist())
        regions = ["" if unknown else self.regions[vertex] for vertex, unknown in known]
        return FrameErrors(self.mean, self.worst, self.vertex, regions, self.flags, frame_numbers, self.neutral)
