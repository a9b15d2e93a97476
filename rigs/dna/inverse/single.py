"""Optimal value of one GUI control with the others fixed, exact and batched over frames.

The error is the sum over outputs of |clamp(slope x + cut + others, 0, 1) - target|. On a segment it is piecewise linear in x:
its minimum is at an end of the segment, or where an output reaches its target or a limit.
"""

import numpy as np

from rigs.dna.inverse.segments import Segments

SAME = 1e-7  # tolerance of equal errors, of which the value nearest to rest is taken


def best_value(segments: Segments, others: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Optimal value of a GUI control for each frame.

    Args:
        others: contribution of other GUI controls to its outputs, `(frame, output)`, or one row for all.
        target: `(frame, output)` in [0, 1].

    Returns:
        Values, their segments, and errors, `(frame,)` each.
    """
    frames = len(target)
    value, segment, error = np.full(frames, segments.rest), np.zeros(frames, np.int64), np.full(frames, np.inf)
    for number, (start, end) in enumerate(segments.ends):
        slopes, cuts = segments.slopes[number], segments.cuts[number] + np.broadcast_to(others, target.shape)
        moving = slopes != 0
        safe = np.where(moving, slopes, 1.0)
        crossings = [(level - cuts[:, moving]) / safe[moving] for level in (target[:, moving], 0.0, 1.0)]
        fixed = np.broadcast_to([start, end, np.clip(segments.rest, start, end)], (frames, 3))
        candidates = np.clip(np.concatenate([fixed, *crossings], axis=1), start, end)
        found = np.clip(slopes * candidates[..., None] + cuts[:, None], 0, 1)
        errors = np.abs(found - target[:, None]).sum(axis=2)
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
