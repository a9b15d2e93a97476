"""In-between shapes, by which tissue moves along arcs around what it covers instead of through it."""

from typing import NamedTuple

import numpy as np

from riginv.geometry.curves import Curve, Key
from rigs.geometry.asset import PARTS

COUNT = 150
JAW_HINGE = np.array([0.0, 705.0, 22.0])  # mm; the jaw rotates about the line through it along x
TISSUE_RADIUS = 25.0  # mm; radius of curvature of what skin elsewhere slides over


class InBetween(NamedTuple):
    """A correction that is full at weight `position` of its shape and zero at 0 and 1."""

    shape: str
    position: float
    deltas: np.ndarray


def build_inbetweens(
    primaries: dict[str, np.ndarray], rest: np.ndarray, normals: np.ndarray, parts: np.ndarray
) -> list[InBetween]:
    """One in-between for each primary shape, two for those whose paths bend the most.

    Args:
        primaries: deltas `(vertex, 3)`, mm, by name.
        rest: `(vertex, 3)`, mm.
        normals: `(vertex, 3)`, unit length, smooth.
        parts: index of each vertex's part in `PARTS`, `(vertex,)`.
    """
    middle = {}
    for name, deltas in primaries.items():
        middle[name] = path_offset(rest, deltas, 0.5, *pivots(name, rest, normals, parts))
    bend = {name: float(np.sqrt((offset**2).sum(axis=1).mean())) for name, offset in middle.items()}
    twice = sorted(bend, key=lambda name: -round(bend[name], 6))[: COUNT - len(primaries)]
    result = []
    for name, deltas in primaries.items():
        for position in (1 / 3, 2 / 3) if name in twice else (0.5,):
            pivot = pivots(name, rest, normals, parts)
            offset = path_offset(rest, deltas, position, *pivot) if position != 0.5 else middle[name]
            result.append(InBetween(name, position, offset))
    return result


def pivots(shape: str, rest: np.ndarray, normals: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres of rotation `(vertex, 3)`, mm, and a mask `(3,)` of the axes in the plane of rotation."""
    if shape.startswith(("eye", "lid")):
        ball = rest[parts == PARTS.index("left_eye" if shape.endswith("Left") else "right_eye")]
        return np.broadcast_to((ball.max(axis=0) + ball.min(axis=0)) / 2, rest.shape), np.ones(3)
    if shape.startswith("jaw") or shape == "mouthClose":
        return np.broadcast_to(JAW_HINGE, rest.shape), np.array([0.0, 1.0, 1.0])
    return rest - TISSUE_RADIUS * normals, np.ones(3)


def path_offset(rest: np.ndarray, deltas: np.ndarray, position: float, centres: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Offset `(vertex, 3)`, mm, of the arc about the centres from the straight path, at a position in [0, 1]."""
    start, end = (rest - centres) * axes, (rest + deltas - centres) * axes
    straight = (1 - position) * start + position * end
    radius = (1 - position) * np.linalg.norm(start, axis=1) + position * np.linalg.norm(end, axis=1)
    return straight * (radius / np.maximum(np.linalg.norm(straight, axis=1), 1e-6) - 1)[:, None]


def bump(position: float, count: int) -> Curve:
    """A driven key from a shape's weight to that of its in-between: 0 at 0 and 1, 1 at `position`.

    Where a shape has one in-between, it is the parabola 4 w (1 - w), the distance of an arc from its chord.
    """
    if count == 1:
        rise = 1 / 3
        return [
            Key(0.0, 0.0, right=(1 / 6, 2 * rise)),
            Key(0.5, 1.0, left=(-1 / 6, 0.0), right=(1 / 6, 0.0)),
            Key(1.0, 0.0, left=(-1 / 6, 2 * rise)),
        ]
    third = 1 / 3
    first = [
        Key(0.0, 0.0, right=(third / 3, 0.6)),
        Key(third, 1.0, left=(-third / 3, 0.0), right=(third / 3, 0.0)),
        Key(2 * third, 0.0, left=(-third / 3, 0.0)),
    ]
    if position < 0.5:
        return first
    return [Key(1 - key.x, key.y, _mirror(key.right), _mirror(key.left)) for key in reversed(first)]


def _mirror(handle: tuple[float, float]) -> tuple[float, float]:
    return -handle[0], handle[1]
