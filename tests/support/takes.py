"""Live Link Face recordings for tests, written apart from the reader."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from riginv.rig.arkit import ARKIT_NAMES

ANGLES = [f"{part}{angle}" for part in ("Head", "LeftEye", "RightEye") for angle in ("Yaw", "Pitch", "Roll")]


def timecode(frame: float, fps: float, count: int, cut: bool = False, separator: str = ":") -> str:
    """The timecode of a frame that counts `count` frames a second; `cut`: whole frames alone."""
    counts = frame / fps * count
    whole = int(counts // count)
    rest = counts - whole * count
    text = f"{int(rest + 1e-6):02d}" if cut else f"{rest:06.3f}"
    return f"{whole // 3600 % 24:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}{separator}{text}"


def drop_frame(frame: int) -> str:
    """SMPTE drop-frame timecode at 29.97 frames a second, counted on from 00:00:00;00 number by number."""
    hours, minutes, seconds, frames = 0, 0, 0, 0
    for _ in range(frame):
        frames += 1
        if frames == 30:
            frames, seconds = 0, seconds + 1
        if seconds == 60:
            seconds, minutes = 0, minutes + 1
            frames = 2 if minutes % 10 else 0
    return f"{hours:02d}:{minutes:02d}:{seconds:02d};{frames:02d}"


def curves(names: Sequence[str], frames: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Smooth weights `(frame,)` in [0, 1] of some shapes."""
    random = np.random.default_rng(seed)
    time = np.linspace(0, 4, frames)
    return {name: (0.5 + 0.5 * np.sin(time * random.uniform(1, 3) + random.uniform(0, 6))).round(6) for name in names}


def write_take(
    path: Path,
    weights: Mapping[str, np.ndarray],
    timecodes: Sequence[str],
    more: Mapping[str, Sequence] | None = None,
    count_column: str = "BlendShapeCount",
    delimiter: str = ",",
    comma: bool = False,
    encoding: str = "utf-8",
    left_out: Sequence[str] = (),
) -> Path:
    """Write a recording with all of ARKit's columns, those that are not given at 0, and the app's angles."""
    names = [name for name in ARKIT_NAMES if name not in left_out]
    columns = {name[0].upper() + name[1:]: weights.get(name, np.zeros(len(timecodes))) for name in names}
    columns |= {name: np.zeros(len(timecodes)) for name in ANGLES} | dict(more or {})
    lines = [delimiter.join(["Timecode", count_column, *columns])]
    for row, code in enumerate(timecodes):
        values = [value[row] if isinstance(value[row], str) else f"{value[row]:.10f}" for value in columns.values()]
        line = delimiter.join([code, "61", *values])
        lines.append(line.replace(".", ",") if comma else line)
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path
