"""Errors and flags of every frame, measured by the true rig."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from riginv.animation.animation import (
    MISSING_VERTICES,
    NOT_CONVERGED,
    OUTSIDE_REACH,
    OUTSIDE_TRAINING_RANGE,
    FrameErrors,
)
from riginv.geometry.distances import FrameDistances, frame_distances
from riginv.inference.inverse import QuickEncoder
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_space import MeshSpace
from riginv.tracking.alternation import WindowResult
from riginv.tracking.estimators import ControlEstimator, NetworkEstimator
from riginv.tracking.options import FlagOptions
from riginv.tracking.stability import TrainingRange

ROUNDING = 1e-6  # of squared distances from rest: what float32 coordinates leave of them on large meshes (measured: 3e-7)


class _Measured(NamedTuple):
    """Measurements of a window's frames.

    Attributes:
        distances, neutral: of the meshes from the recovered ones, and from the rest mesh.
        coordinates: mesh coordinates of the filled meshes, `(frame, coordinate)`.
        squares: the sum of the squared distances of these from the rest mesh, `(frame,)`, mm^2.
        has_unknown: whether a vertex is not known, `(frame,)`.
    """

    distances: FrameDistances
    neutral: FrameDistances
    coordinates: Tensor
    squares: Tensor
    has_unknown: Tensor


class FrameEvaluator:
    """Evaluates windows, from several threads if need be, and keeps the errors and flags of their frames.

    Args:
        frames: number of frames of the clip.
        true_rig: makes the meshes that are compared.
        rig: made the recovered meshes; they serve if it is the true rig.
        space: its mesh space, unweighted.
        estimator: reports whether frames converged.
        training: what the network was trained on; None without a network.
        evaluated: the vertices that count, `(vertex,)`; None: all.
        regions: region name of each vertex.
        limits: when a frame is flagged.
    """

    def __init__(
        self,
        frames: int,
        true_rig: RigBackend,
        rig: RigBackend,
        space: MeshSpace,
        estimator: ControlEstimator,
        training: TrainingRange | None,
        evaluated: Tensor | None,
        regions: Sequence[str],
        limits: FlagOptions,
    ) -> None:
        self.true_rig, self.rig, self.space, self.estimator, self.training = true_rig, rig, space, estimator, training
        self.encode = estimator.encode if isinstance(estimator, NetworkEstimator) else space.encode
        self.evaluated, self.regions, self.limits = evaluated, regions, limits
        # Allocated once: small tensors between large temporary ones would fragment memory.
        self.mean, self.worst = torch.full((frames,), torch.nan), torch.full((frames,), torch.nan)
        self.neutral = torch.full((frames,), torch.nan)
        self.vertex = torch.zeros(frames, dtype=torch.long)
        self.flags: list[list[str]] = [[] for _ in range(frames)]

    @torch.no_grad()
    def add(self, first: int, found: WindowResult, converged: Tensor | None = None) -> None:
        """Evaluate the frames of a window.

        Args:
            first: index of its first frame in the clip.
            converged: whether each frame did, `(frame,)`, where it is known; else the estimator tells.
        """
        measured = self._in_one_pass(found) or self._in_several_passes(found)
        distances, neutral = measured.distances, measured.neutral
        mean = torch.where(distances.known > 0, distances.mean, torch.nan)
        rows = slice(first, first + len(mean))
        self.mean[rows], self.vertex[rows] = mean, distances.vertex
        self.worst[rows] = torch.where(distances.known > 0, distances.worst, torch.nan)
        self.neutral[rows] = torch.where(neutral.known > 0, neutral.mean, torch.nan)
        if converged is None:
            is_network = isinstance(self.estimator, NetworkEstimator)
            converged = self.estimator.converged(found.vertices if is_network else found.filled, found.controls)
        self.flags[rows] = self._flags(found, measured, mean, converged)

    def _in_one_pass(self, found: WindowResult) -> _Measured | None:
        """The measurements by one pass over the vertices; None where a vertex is not known, or there is no kernel for it."""
        rig, encode = self.rig, self.encode
        if self.evaluated is not None or self.true_rig is not rig or not isinstance(encode, QuickEncoder):
            return None
        if encode.rig[0].source is not rig or not isinstance(rig, LinearRig):
            return None
        change = rig.coefficients(found.controls) - rig.neutral_coefficients()
        given = encode.compare(found.vertices, found.motion, change)
        if given is None or bool((given[1].known < found.vertices.shape[1]).any()):
            return None
        coordinates, distances, neutral = given
        return _Measured(distances, neutral, coordinates, neutral.squares, torch.zeros_like(found.solvable))

    def _in_several_passes(self, found: WindowResult) -> _Measured:
        recovered = found.recovered if self.true_rig is self.rig else self.true_rig(found.controls)
        distances = frame_distances(found.stabilised, recovered, self.evaluated)
        neutral = frame_distances(found.stabilised, self.true_rig.rest_vertices[None], self.evaluated)
        filled = found.filled
        if self.evaluated is not None:
            filled = torch.where(self.evaluated[:, None], filled, found.recovered)
        if filled is found.stabilised and self.true_rig is self.rig:
            squares, has_unknown = neutral.squares, torch.zeros_like(found.solvable)
        else:
            squares = frame_distances(filled, self.space.rest_vertices[None]).squares
            has_unknown = ~torch.isfinite(found.stabilised).all(dim=2).all(dim=1)
        return _Measured(distances, neutral, self.encode(filled), squares, has_unknown)

    def _flags(self, found: WindowResult, measured: _Measured, mean: Tensor, converged: Tensor) -> list[list[str]]:
        coordinates = measured.coordinates
        residual = (1 - ROUNDING) * measured.squares - coordinates.double().square().sum(dim=1)
        unreachable = (residual.clamp_min(0) / self.space.vertex_count).sqrt() > self.limits.reach_mm
        is_poor = mean > self.limits.reach_mm
        if isinstance(self.estimator, NetworkEstimator):  # the error may be the network's, and only a solver could show it
            converged = converged & (~is_poor | unreachable)
        unusual = torch.zeros_like(converged)
        if self.training is not None:
            unusual = self.training.outside_mm(coordinates) > self.limits.range_mm
        named = {
            OUTSIDE_TRAINING_RANGE: unusual & found.solvable,
            OUTSIDE_REACH: (unreachable | (is_poor & converged)) & found.solvable,
            NOT_CONVERGED: ~converged & found.solvable,
            MISSING_VERTICES: measured.has_unknown,
        }
        rows = zip(*(flagged.tolist() for flagged in named.values()))
        return [[name for name, flagged in zip(named, row) if flagged] for row in rows]

    def errors(self, frame_numbers: Tensor) -> FrameErrors:
        """The errors of all frames added so far."""
        worst = zip(self.vertex.tolist(), self.mean.isnan().tolist())
        regions = ["" if unknown else self.regions[vertex] for vertex, unknown in worst]
        return FrameErrors(self.mean, self.worst, self.vertex, regions, self.flags, frame_numbers, self.neutral)
