"""Plausibility of a clip's motion: warnings of no motion, repeated frames, and implausible speed."""

from typing import NamedTuple

import torch
from torch import Tensor

from riginv.geometry.distances import frame_distances

STILL = 1e-5  # of the mesh size: smaller displacements from the first frame are no motion
SAME = 1e-6  # of the mesh size: frames that differ by less are the same
LONGEST_REPEAT = 8  # consecutive equal frames; more are a held pose
REPEATED = 0.15  # fraction of equal frames that is reported; 24 fps written as 30 fps has 0.2
FEWEST_REPEATED = 4  # frames
REGULAR = 0.8  # fraction of the meshes repeated equally often, for "every mesh is repeated"
FASTEST_M_S = 20.0  # speed of a hand in a punch
KNOWN = 0.5  # fraction of known vertices that a frame needs to be measured


class ClipMotion(NamedTuple):
    """The motion of a clip over the frames read so far.

    Attributes:
        frames, all_frames: number of frames read, and of all.
        unknown: number of frames read with too few known vertices.
        size_mm: extent of the first known frame along x, y and z, mm, y up.
        farthest_mm: largest displacement of a vertex from that frame.
        fastest_m_s: largest speed of a vertex between two frames; 0 where the unit is not known.
        warnings: sentences: it never moves, frames repeat, it moves too fast.
    """

    frames: int
    all_frames: int
    unknown: int
    size_mm: tuple[float, float, float]
    farthest_mm: float
    fastest_m_s: float
    warnings: tuple[str, ...]


class MotionCheck:
    """Measures how a clip moves while its windows are read; keeps a few numbers per frame and two meshes.

    Args:
        frame_numbers: `(frame,)`.
        fps: frames per second.
        has_unit: whether lengths are in mm, so that speeds are known.
    """

    def __init__(self, frame_numbers: Tensor, fps: float, has_unit: bool = True) -> None:
        count = len(frame_numbers)
        self.frame_numbers, self.fps, self.has_unit = frame_numbers, fps, has_unit
        self.seen = torch.zeros(count, dtype=torch.bool)
        self.displacement_mm = torch.full((count,), torch.nan)  # largest of a vertex, from the first known frame
        self.moved_mm = torch.full((count,), torch.nan)  # largest of a vertex, from the frame before
        self.moved_vertex = torch.zeros(count, dtype=torch.long)
        self.extent = torch.zeros(3)
        self._first: Tensor | None = None
        self._last: tuple[int, Tensor] | None = None

    def add(self, start: int, vertices: Tensor) -> None:
        """Measure frames `(frame, vertex, 3)`, mm; the first is frame `start` of the clip."""
        if not len(vertices):
            return
        before = self._last[1] if self._last and self._last[0] == start - 1 else None
        rows = torch.arange(start, start + len(vertices))
        follows = torch.ones(len(rows), dtype=torch.bool)
        follows[0] = before is not None
        new = ~self.seen[rows] | (follows & self.moved_mm[rows].isnan())
        if bool(new.any()):
            self._measure(rows, vertices, vertices[:1] if before is None else before[None], new, follows)
        self._last = (int(rows[-1]), vertices[-1].clone())  # a view would keep the window in memory

    def _measure(self, rows: Tensor, vertices: Tensor, before: Tensor, new: Tensor, follows: Tensor) -> None:
        """Measure the new ones of consecutive frames; `before` is the mesh before them, where the first one follows one."""
        self.seen[rows] = True
        enough = torch.ones(len(rows), dtype=torch.bool)
        if not bool(vertices.sum().isfinite()):
            enough = torch.isfinite(vertices).all(dim=2).float().mean(dim=1) > KNOWN
        if self._first is None:
            if not bool(enough.any()):
                return
            self._first = vertices[int(enough.int().argmax())].clone()
            known = self._first[torch.isfinite(self._first).all(dim=1)]
            self.extent = known.amax(dim=0) - known.amin(dim=0)
        far = frame_distances(vertices, self._first[None])
        steps = (frame_distances(vertices[:1], before), frame_distances(vertices[1:], vertices[:-1]))
        distance, vertex = (torch.cat([getattr(step, name) for step in steps]) for name in ("worst", "vertex"))
        new, moved = new & enough, new & enough & follows
        self.displacement_mm[rows[new]] = far.worst[new]
        self.moved_mm[rows[moved]], self.moved_vertex[rows[moved]] = distance[moved], vertex[moved]

    @property
    def motion(self) -> ClipMotion:
        """The motion of the frames read so far."""
        displacement = self.displacement_mm[~self.displacement_mm.isnan()]
        speed, row = self._fastest()
        return ClipMotion(
            int(self.seen.sum()),
            len(self.seen),
            int(self.seen.sum()) - len(displacement),
            (float(self.extent[0]), float(self.extent[1]), float(self.extent[2])),
            float(displacement.max()) if len(displacement) else 0.0,
            speed,
            tuple(filter(None, (self._never_moves(displacement), self._repeats(), self._too_fast(speed, row)))),
        )

    @property
    def _size(self) -> float:
        return float(self.extent.norm())

    def _never_moves(self, displacement: Tensor) -> str:
        """The warning that it never moves, or an empty text."""
        if len(displacement) < 2 or float(displacement.max()) > STILL * self._size:
            return ""
        read, count = len(displacement), len(self.seen)
        frames = f"all its {count:,} frames are" if read == count else f"the {read:,} of {count:,} frames looked at are all"
        return f"it never moves: {frames} the same mesh (reading.mesh and reading.animation choose what is read)"

    def _fastest(self) -> tuple[float, int]:
        """The largest speed in metres per second, and the row of the frame after it."""
        if len(self.seen) < 2 or not self.has_unit:
            return 0.0, 0
        seconds = self.frame_numbers.diff().double() / self.fps
        speeds = (self.moved_mm[1:].double() / 1000 / seconds).nan_to_num(0.0)
        row = int(speeds.argmax())
        return float(speeds[row]), row + 1

    def _too_fast(self, speed: float, row: int) -> str:
        """The warning of a speed that is implausible for people, or an empty text."""
        if speed <= FASTEST_M_S:
            return ""
        before, after = self.frame_numbers[row - 1 : row + 1].tolist()
        return (
            f"it moves too fast: vertex {int(self.moved_vertex[row])} at {speed:,.0f} m/s from frame {before} to {after}, "
            f"people at up to {FASTEST_M_S:g}: the rate (reading.fps), the unit (reading.unit) or the order of frames is wrong"
        )

    def _repeats(self) -> str:
        """The warning that frames repeat, or an empty text."""
        measured = ~self.moved_mm.isnan()
        same = (self.moved_mm <= SAME * self._size) & measured
        runs = [run for run in _runs(same) if run <= LONGEST_REPEAT]
        moving, repeated = int((measured & ~same).sum()), sum(runs)
        if not moving or repeated < FEWEST_REPEATED or repeated < REPEATED * (repeated + moving):
            return ""
        regular = len(set(runs)) == 1 and len(runs) >= REGULAR * moving
        rate = self.fps / (runs[0] + 1) if regular else self.fps * moving / (repeated + moving)
        finding = f"{repeated:,} of {int(measured.sum()):,} frames are the same as the one before"
        if regular:
            finding = f"every mesh is there {runs[0] + 1} times in a row"
        advice = f" (after.fps={rate:.3g} gives curves at that rate)" if regular else ""
        return f"its frames repeat: {finding}: written at {self.fps:g} frames a second and animated at about {rate:.3g}{advice}"


def _runs(flags: Tensor) -> list[int]:
    """The length of each run of set flags `(frame,)`."""
    edges = torch.cat([flags.new_zeros(1), flags, flags.new_zeros(1)]).int().diff()
    return ((edges == -1).nonzero()[:, 0] - (edges == 1).nonzero()[:, 0]).tolist()
