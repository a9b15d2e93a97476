"""What was read of a clip, so that the user can see whether it is what was meant; `riginv.clips.description_text` says it."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from riginv.clips.clip import Clip
from riginv.clips.motion_check import ClipMotion
from riginv.clips.sequence import SourceFacts
from riginv.geometry.neighbours import evenly

NAMED = 3  # of missing frames
BLOCKS, BLOCK = 6, 16  # runs of frames that are looked at before any work, and how many frames each has
MOST_BYTES = 256_000_000  # of meshes that are looked at


class FrameSpan(NamedTuple):
    """Some frames: the numbers of the first and the last, and how many there are."""

    first: int
    last: int
    count: int


@dataclass(frozen=True)
class ClipDescription:
    """What was read of a clip.

    Attributes:
        file: its name.
        facts: what its reader took from the file and what it passed over.
        vertices, faces: of each mesh; no faces where the file has none.
        frames: those that were taken, of `all_frames` in the file.
        missing: how many frames between the first and the last are not there; `missing_first` are the first few.
        excluded: how many of the frames are treated as unknown because the user said so.
        fps: frames a second; `rate_source` says where they come from.
        unit_mm: millimetres to a unit of the file; None: not known, and lengths are in that unit. `unit_source`: from where.
        up: the axis of the file that points up; `up_source` says where that comes from.
        motion: how it moves, and its size.
        notes: whole sentences: what was mended or guessed.
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
        """From the first frame to the last."""
        return (self.frames.last - self.frames.first) / self.fps

    @property
    def warnings(self) -> tuple[str, ...]:
        """Whole sentences about what can hardly be meant."""
        return self.motion.warnings

    def new_warnings(self, before: "ClipDescription") -> list[str]:
        """Those that were not there before more of the clip was read."""
        known = {warning.partition(":")[0] for warning in before.warnings}
        return [warning for warning in self.warnings if warning.partition(":")[0] not in known]

    def as_json(self) -> dict[str, Any]:
        """All of it as plain values, for a sidecar."""
        facts, motion = asdict(self.facts), self.motion
        return {
            "file": self.file,
            **{key: list(value) if isinstance(value, tuple) else value for key, value in facts.items()},
            "vertices": self.vertices,
            "faces": self.faces,
            "frames": {**self.frames._asdict(), "missing": self.missing, "excluded": self.excluded},
            "all_frames": self.all_frames._asdict(),
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
    """What was read of a clip; of one that was not read yet a bounded number of frames is looked at.

    Raises:
        InputError: the file turns out to be damaged.
    """
    look(clip)
    sequence, units, numbers = clip.sequence, clip.units, clip.frame_numbers.numpy()
    missing, some = _missing(numbers)
    return ClipDescription(
        file=Path(sequence.path).name or sequence.path,
        facts=sequence.facts,
        vertices=sequence.vertex_count,
        faces=len(sequence.faces) if sequence.faces else 0,
        frames=_span(numbers),
        all_frames=_span(sequence.frame_numbers),
        missing=missing,
        missing_first=some,
        excluded=int(clip.excluded.sum()),
        fps=units.fps,
        rate_source=units.rate_source,
        unit_mm=units.mm if units.unit_source else None,
        unit_source=units.unit_source,
        up=units.up,
        up_source=units.up_source,
        motion=clip.motion_check.motion,
        notes=(*sequence.facts.notes, *units.notes),
    )


def look(clip: Clip) -> None:
    """Read some frames of a clip, in a few runs spread over it, so that its motion can be told; all of a short one."""
    most = max(2, min(BLOCKS * BLOCK, MOST_BYTES // (12 * clip.sequence.vertex_count)))
    blocks = [(0, len(clip))] if len(clip) <= most else _blocks(len(clip), most)
    for start, stop in blocks:
        for row in range(start, stop, BLOCK):
            end = min(row + BLOCK, stop)
            if not bool(clip.motion_check.seen[row:end].all()):
                clip.vertices(row, end)


def _blocks(frames: int, most: int) -> list[tuple[int, int]]:
    size = max(2, min(BLOCK, most // BLOCKS))
    starts = evenly(max(1, most // size), frames - size + 1).tolist()
    return [(start, start + size) for start in starts]


def _span(numbers: np.ndarray) -> FrameSpan:
    return FrameSpan(int(numbers[0]), int(numbers[-1]), len(numbers))


def _missing(numbers: np.ndarray) -> tuple[int, tuple[int, ...]]:
    """How many frames are not there between those that are, and the first few of them."""
    steps = np.diff(numbers)
    if not len(steps):
        return 0, ()
    step = int(steps.min())
    some = [
        int(number)
        for row in np.flatnonzero(steps > step)[:NAMED]
        for number in range(int(numbers[row]) + step, min(int(numbers[row + 1]), int(numbers[row]) + (NAMED + 1) * step), step)
    ]
    return int((steps // step - 1).sum()), tuple(some[:NAMED])
