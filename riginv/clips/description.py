"""The description of what was read of a clip, for the user to check; `riginv.clips.description_text` formats it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from riginv.clips.clip import Clip
from riginv.clips.motion_check import ClipMotion
from riginv.clips.sequence import SourceFacts
from riginv.clips.units import ClipUnits
from riginv.geometry.neighbours import evenly

LISTED = 3  # missing frames in a message
BLOCKS, BLOCK = 6, 16  # runs of consecutive frames sampled before any work, and their length
MAX_BYTES = 256_000_000  # of sampled meshes


@dataclass(frozen=True)
class FrameSpan:
    """A range of frames: first and last frame number, and how many frames there are."""

    first: int
    last: int
    count: int


@dataclass(frozen=True)
class ClipDescription:
    """The description of a clip: the properties that were read, stated or guessed.

    Attributes:
        file: its name.
        facts: what its reader took from the file and what it skipped.
        vertices, faces: of each mesh; no faces where the file has none.
        frames: those taken, of `all_frames` in the file.
        missing: number of frames absent between the first and the last; `missing_first` lists the first few.
        excluded: number of frames treated as unknown on the user's request.
        fps: frames per second; `rate_source`: where it comes from.
        unit_mm: millimetres to a unit of the file; None: not known, and lengths are in that unit. `unit_source`: from where.
        up: the up axis of the file; `up_source`: where it comes from.
        motion: how it moves, and its size.
        notes: sentences: what was repaired or guessed.
    """

    file: str
    facts: SourceFacts
    vertices: int
    faces: int
    frames: FrameSpan
    all_frames: FrameSpan
    missing: int
    missing_first: tuple[int, ...]
    excluded: int
    fps: float
    rate_source: str
    unit_mm: float | None
    unit_source: str
    up: str
    up_source: str
    motion: ClipMotion
    notes: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Time from the first frame to the last."""
        return (self.frames.last - self.frames.first) / self.fps

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about implausible values."""
        return self.motion.warnings

    def new_warnings(self, before: "ClipDescription") -> list[str]:
        """Warnings that `before`, made when less of the clip had been read, did not have."""
        known = {warning.partition(":")[0] for warning in before.warnings}
        return [warning for warning in self.warnings if warning.partition(":")[0] not in known]

    def as_json(self) -> dict[str, Any]:
        """All of it as plain values, for curves.json."""
        facts, motion = asdict(self.facts), self.motion
        return {
            "file": self.file,
            **{key: list(value) if isinstance(value, tuple) else value for key, value in facts.items()},
            "vertices": self.vertices,
            "faces": self.faces,
            "frames": {**asdict(self.frames), "missing": self.missing, "excluded": self.excluded},
            "all_frames": asdict(self.all_frames),
            "fps": self.fps,
            "rate_source": self.rate_source,
            "seconds": self.seconds,
            "size_mm" if self.unit_mm else "size": list(motion.size_mm),
            "unit_mm": self.unit_mm,
            "unit_source": self.unit_source,
            "up": self.up,
            "up_source": self.up_source,
            "farthest_mm": motion.farthest_mm,
            "fastest_m_s": motion.fastest_m_s,
            "frames_looked_at": motion.frames,
            "notes": list(self.notes),
            "warnings": list(motion.warnings),
        }


def describe(clip: Clip) -> ClipDescription:
    """The description of a clip; a bounded number of frames is sampled if it has not been read yet.

    Raises:
        InputError: the file turns out to be damaged.
    """
    sample(clip)
    sequence, units, numbers = clip.sequence, clip.units, clip.frame_numbers.numpy()
    spans = span_of(numbers), span_of(sequence.frame_numbers), missing_frames(numbers), int(clip.excluded.sum())
    notes, faces = [*sequence.facts.notes, *units.notes], len(sequence.faces) if sequence.faces else 0
    motion = clip.motion_check.motion
    return describe_points(sequence.path, sequence.facts, sequence.vertex_count, *spans, units, motion, notes, faces)


def describe_points(
    path: str,
    facts: SourceFacts,
    points: int,
    frames: FrameSpan,
    all_frames: FrameSpan,
    missing: tuple[int, tuple[int, ...]],
    excluded: int,
    units: ClipUnits,
    motion: ClipMotion,
    notes: Sequence[str],
    faces: int = 0,
) -> ClipDescription:
    """The description of a clip of meshes, scans or markers; arguments as in `ClipDescription`.

    Args:
        missing: as `missing_frames`.
    """
    return ClipDescription(
        file=Path(path).name or path,
        facts=facts,
        vertices=points,
        faces=faces,
        frames=frames,
        all_frames=all_frames,
        missing=missing[0],
        missing_first=missing[1],
        excluded=excluded,
        fps=units.fps,
        rate_source=units.rate_source,
        unit_mm=units.mm if units.unit_source else None,
        unit_source=units.unit_source,
        up=units.up,
        up_source=units.up_source,
        motion=motion,
        notes=tuple(notes),
    )


def sample(clip: Clip) -> None:
    """Read some frames of a clip, in a few runs spread over it, to measure its motion; all frames of a short clip."""
    count = max(2, min(BLOCKS * BLOCK, MAX_BYTES // (12 * clip.sequence.vertex_count)))
    blocks = [(0, len(clip))] if len(clip) <= count else _blocks(len(clip), count)
    for start, stop in blocks:
        for row in range(start, stop, BLOCK):
            end = min(row + BLOCK, stop)
            if not bool(clip.motion_check.seen[row:end].all()):
                clip.vertices(row, end)


def _blocks(frames: int, count: int) -> list[tuple[int, int]]:
    size = max(2, min(BLOCK, count // BLOCKS))
    starts = evenly(max(1, count // size), frames - size + 1).tolist()
    return [(start, start + size) for start in starts]


def span_of(numbers: np.ndarray) -> FrameSpan:
    """The span of frame numbers `(frame,)`."""
    return FrameSpan(int(numbers[0]), int(numbers[-1]), len(numbers))


def missing_frames(numbers: np.ndarray) -> tuple[int, tuple[int, ...]]:
    """The number of missing frames, and the first few of them."""
    steps = np.diff(numbers)
    if not len(steps):
        return 0, ()
    step = int(steps.min())
    listed = [
        int(number)
        for row in np.flatnonzero(steps > step)[:LISTED]
        for number in range(int(numbers[row]) + step, min(int(numbers[row + 1]), int(numbers[row]) + (LISTED + 1) * step), step)
    ]
    return int((steps // step - 1).sum()), tuple(listed[:LISTED])
