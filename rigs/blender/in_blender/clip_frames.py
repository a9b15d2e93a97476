"""Inside Blender: the frames of an imported Alembic or FBX file."""

import math

import bpy
import numpy as np
from alembic_times import Frames, archive_frames
from takes import Take
from worker import RefusedError

MOST_FRAMES = 10_000_000
DEFAULT_FPS = 30.0
SLOWEST, FASTEST = 5.0, 1000.0  # plausible frame rates
NEAR = 1e-2  # tolerance in frames


def set_rate(fps: float) -> None:
    """Set the frame rate of the scene, before an import."""
    render = bpy.context.scene.render
    render.fps = max(1, round(fps))
    render.fps_base = render.fps / fps


def archive_rate(file: str, requested: float | None) -> float:
    """Frame rate for the import of an archive."""
    archive = archive_frames(file)
    return requested or (archive.fps if archive else 0.0) or DEFAULT_FPS


def alembic_frames(file: str, requested: float | None) -> Frames:
    """The frames of an archive: its own, or at the rate that the user requested.

    Raises:
        RefusedError: there are too many.
    """
    archive, scene = archive_frames(file), bpy.context.scene
    if archive and not requested:
        return archive
    if archive and not archive.fps:  # its seconds cannot be meant
        return archive._replace(fps=requested, source="reading.fps")
    if requested:
        ends = (archive.seconds[[0, -1]] * requested).round() if archive else (scene.frame_start, scene.frame_end)
        return _whole_frames(file, int(ends[0]), int(ends[1]), requested, "reading.fps")
    frames = _whole_frames(file, scene.frame_start, scene.frame_end, DEFAULT_FPS, "")
    if len(frames.numbers) == 1:
        return frames._replace(fps=0.0)
    note = f"Blender does not provide the times of its samples: {DEFAULT_FPS:g} frames a second were played (reading.fps=...)."
    return frames._replace(fps=0.0, notes=(note,))


def fbx_frames(file: str, take: Take | None, requested: float | None) -> Frames:
    """The frames of a take, at the file's rate or the one that the user requested.

    Raises:
        RefusedError: there are too many.
    """
    render = bpy.context.scene.render
    rate, source, notes = render.fps / render.fps_base, "the FBX's own rate", []
    keys = take.key_times() / render.fps if take else np.zeros(0)
    if not len(keys):
        return Frames(
            np.zeros(1, np.int64), np.zeros(1), requested or rate, source, ("Nothing has keys: one still frame was read.",)
        )
    if requested:
        rate, source = requested, "reading.fps"
    elif not _is_on(keys, rate):
        finer = 1 / float(np.median(np.diff(keys)))
        if _is_on(keys, finer) and SLOWEST <= finer <= FASTEST:
            notes.append(
                f"The FBX states {rate:g} frames a second, and its keys stand at {finer:.6g} a second: these were read."
            )
            rate, source = finer, "the spacing of its keys"
        else:
            notes.append(f"Keys stand between the FBX's {rate:g} frames a second (reading.fps=... reads at another rate).")
    first, last = math.ceil(keys[0] * rate - NEAR), math.floor(keys[-1] * rate + NEAR)
    return _whole_frames(file, first, max(first, last), rate, source)._replace(notes=tuple(notes))


def _whole_frames(file: str, first: int, last: int, rate: float, source: str) -> Frames:
    if last - first > MOST_FRAMES:
        raise RefusedError(f"{file}: frames {first} to {last} are more than can be meant: damaged? export it again")
    numbers = np.arange(first, last + 1)
    return Frames(numbers, numbers / rate, rate, source)


def _is_on(keys: np.ndarray, rate: float) -> bool:
    """Whether all keys, in seconds, stand at whole frames; Blender keeps them as float32."""
    frames = keys * rate
    return bool((np.abs(frames - np.round(frames)) <= NEAR + 1e-6 * np.abs(frames)).all())
