"""The best value of one GUI control, the others fixed: exact, for many frames at once.

The error is the sum over outputs of |clamp(slope x + cut + others, 0, 1) - wanted|. On a segment it is piecewise linear in x:
its minimum is at an end of the segment, where an output reaches what is wanted, or where one reaches a limit.
"""

import numpy as np

from rigs.dna.inverse.segments import Segments

SAME = 1e-7  # errors that differ by less are equal: then the value nearest to rest is taken


def best_value(segments: Segments, others: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best value of a GUI control for each frame.

    Args:
        others: what other GUI controls add to its outputs, `(frame, output)`, or one row for all.
        wanted: `(frame, output)` in [0, 1].

    Returns:
        The values `(frame,)`, the segments they lie on `(frame,)`, and the errors `(frame,)`.
    """
    frames = len(wanted)
    value, segment, error = np.full(frames, segments.rest), np.zeros(frames, np.int64), np.full(frames, np.inf)
    for number, (start, end) in enumerate(segments.ends):
        slopes, cuts = segments.slopes[number], segments.cuts[number] + np.broadcast_to(others, wanted.shape)
        moving = slopes != 0
        safe = np.where(moving, slopes, 1.0)
        crossings = [(level - cuts[:, moving]) / safe[moving] for level in (wanted[:, moving], 0.0, 1.0)]
        fixed = np.broadcast_to([start, end, np.clip(segments.rest, start, end)], (frames, 3))
        candidates = np.clip(np.concatenate([fixed, *crossings], axis=1), start, end)
        found = np.clip(slopes * candidates[..., None] + cuts[:, None], 0, 1)
        errors = np.abs(found - wanted[:, None]).sum(axis=2)
        away = np.abs(candidates - segments.rest)
        near = np.where(errors <= errors.min(axis=1, keepdims=True) + SAME, away, np.inf)
        best = near.argmin(axis=1)
        row = np.arange(frames)
        better = (errors[row, best] < error - SAME) | (
            (errors[row, best] < error + SAME) & (near[row, best] < np.abs(value - segments.rest))
        )
        value = np.where(better, candidates[row, best], value)
        segment = np.where(better, number, segment)
        error = np.where(better, errors[row, best], error)
    return value, segment, error
