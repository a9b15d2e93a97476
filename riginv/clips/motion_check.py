"""Whether a clip moves as a performance does: not at all, with repeated frames, or faster than people move."""

from typing import NamedTuple

import torch
from torch import Tensor

STILL = 1e-5  # of the mesh's size: a vertex that stays within so much of its first place does not move
SAME = 1e-6  # of the mesh's size: frames that differ by no more are the same
LONGEST_REPEAT = 8  # frames in a row that are the same; more are a pose that is held
REPEATED = 0.15  # fraction of the frames between movements that repeat the one before: 24 a second as 30 have 0.2
FEWEST_REPEATED = 4  # frames
REGULAR = 0.8  # of the meshes that follow one another, repeated alike: every mesh is
FASTEST_M_S = 20.0  # what a hand reaches in a blow
KNOWN = 0.5  # fraction of the vertices, for a frame to be looked at


class ClipMotion(NamedTuple):
    """How a clip moves, as far as it was looked at.

    Attributes:
        frames, all_frames: how many were looked at, of how many.
        unknown: how many of those have too few known vertices to tell.
        size_mm: extent of the first known frame along x, y and z, mm, y up.
        farthest_mm: how far a vertex goes from its place in that frame.
        fastest_m_s: the greatest speed of a vertex between two frames; 0 where the unit is not known.
        warnings: whole sentences: that it never moves, that frames repeat, that it is too fast.
    """

    frames: int
    all_frames: int
    unknown: int
    size_mm: tuple[float, float, float]
    farthest_mm: float
    fastest_m_s: float
    warnings: tuple[str, ...]


class MotionCheck:
    """Gathers how a clip moves while its windows go by; a few numbers of each frame and two meshes are kept.

    Args:
        frame_numbers: `(frame,)`.
        fps: frames a second.
        has_unit: whether lengths are in mm, so that speeds can be told.
    """

    def __init__(self, frame_numbers: Tensor, fps: float, has_unit: bool = True) -> None:
        count = len(frame_numbers)
        self.frame_numbers, self.fps, self.has_unit = frame_numbers, fps, has_unit
        self.seen = torch.zeros(count, dtype=torch.bool)
        self.away_mm = torch.full((count,), torch.nan)  # from the first known frame
        self.moved_mm = torch.full((count,), torch.nan)  # the largest of a vertex, from the frame before
        self.moved_vertex = torch.zeros(count, dtype=torch.long)
        self.extent = torch.zeros(3)
        self._first: Tensor | None = None
        self._last: tuple[int, Tensor] | None = None

    def add(self, start: int, vertices: Tensor) -> None:
        """Look at frames `(frame, vertex, 3)`, mm, of which the first is frame `start` of the clip."""
        before = self._last[1] if self._last and self._last[0] == start - 1 else None
        for row, mesh in enumerate(vertices, start=start):
            if not self.seen[row] or (before is not None and self.moved_mm[row].isnan()):
                self._look(row, mesh, before)
            before = mesh
        if before is not None and len(vertices):
            self._last = (start + len(vertices) - 1, before.clone())  # a view would keep the whole window

    def _look(self, row: int, mesh: Tensor, before: Tensor | None) -> None:
        self.seen[row] = True
        known = torch.isfinite(mesh).all(dim=1)
        if float(known.float().mean()) <= KNOWN:
            return
        if self._first is None:
            self._first = mesh.clone()
            self.extent = mesh[known].amax(dim=0) - mesh[known].amin(dim=0)
        self.away_mm[row] = _farthest(mesh, self._first)[0]
        if before is not None:
            self.moved_mm[row], self.moved_vertex[row] = _farthest(mesh, before)

    @property
    def motion(self) -> ClipMotion:
        """What was found up to now."""
        away = self.away_mm[~self.away_mm.isnan()]
        speed, row = self._fastest()
        return ClipMotion(
            int(self.seen.sum()),
            len(self.seen),
            int(self.seen.sum()) - len(away),
            tuple(self.extent.tolist()),
            float(away.max()) if len(away) else 0.0,
            speed,
            tuple(filter(None, (self._still(away), self._repeats(), self._too_fast(speed, row)))),
        )

    @property
    def _size(self) -> float:
        return float(self.extent.norm())

    def _still(self, away: Tensor) -> str:
        """Says that it never moves."""
        if len(away) < 2 or float(away.max()) > STILL * self._size:
            return ""
        looked, count = len(away), len(self.seen)
        said = f"all its {count:,} frames are" if looked == count else f"the {looked:,} of {count:,} frames looked at are all"
        return f"it never moves: {said} the same mesh (reading.mesh and reading.animation choose what is read)"

    def _fastest(self) -> tuple[float, int]:
        """The greatest speed in metres a second, and the frame that it leads to."""
        if len(self.seen) < 2 or not self.has_unit:
            return 0.0, 0
        seconds = self.frame_numbers.diff().double() / self.fps
        speeds = (self.moved_mm[1:].double() / 1000 / seconds).nan_to_num(0.0)
        row = int(speeds.argmax())
        return float(speeds[row]), row + 1

    def _too_fast(self, speed: float, row: int) -> str:
        """Says that it moves faster than people do."""
        if speed <= FASTEST_M_S:
            return ""
        before, after = self.frame_numbers[row - 1 : row + 1].tolist()
        return (
            f"it moves too fast: vertex {int(self.moved_vertex[row])} at {speed:,.0f} m/s from frame {before} to {after}, "
            f"people at up to {FASTEST_M_S:g}: the rate (reading.fps), the unit (reading.unit) or the order of frames is wrong"
        )

    def _repeats(self) -> str:
        """Says that frames repeat, where it is no pose that is held."""
        looked = ~self.moved_mm.isnan()
        same = (self.moved_mm <= SAME * self._size) & looked
        runs = [run for run in _runs(same) if run <= LONGEST_REPEAT]
        moving, repeated = int((looked & ~same).sum()), sum(runs)
        if not moving or repeated < FEWEST_REPEATED or repeated < REPEATED * (repeated + moving):
            return ""
        regular = len(set(runs)) == 1 and len(runs) >= REGULAR * moving
        rate = self.fps / (runs[0] + 1) if regular else self.fps * moving / (repeated + moving)
        said = f"{repeated:,} of {int(looked.sum()):,} frames are the same as the one before"
        if regular:
            said = f"every mesh is there {runs[0] + 1} times in a row"
        advice = f" (after.fps={rate:.3g} gives curves at that rate)" if regular else ""
        return f"its frames repeat: {said}: written at {self.fps:g} frames a second and animated at about {rate:.3g}{advice}"


def _farthest(mesh: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """The largest distance between two meshes `(vertex, 3)`, of the vertices that both know, and whose it is."""
    return (mesh - other).norm(dim=1).nan_to_num(0.0).max(dim=0)


def _runs(flags: Tensor) -> list[int]:
    """How long each stretch of flags `(frame,)` is."""
    edges = torch.cat([flags.new_zeros(1), flags, flags.new_zeros(1)]).int().diff()
    return ((edges == -1).nonzero()[:, 0] - (edges == 1).nonzero()[:, 0]).tolist()
