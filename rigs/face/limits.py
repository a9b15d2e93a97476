"""Limits on the weights of regions, and on a shape by another shape."""

from typing import NamedTuple

from riginv.geometry.curves import Curve, Key

REGIONS = ("eyeLeft", "eyeRight", "brow", "cheek", "nose", "mouth")

# Sum of a region's weights (a half counts 0.5) up to which nothing is attenuated. A real range-of-motion take reaches
# 2.4 at an eye, 2.0 at the brow, 0.7 at cheeks, 0.8 at the nose and 4.4 at the mouth.
CAPACITY = {"eyeLeft": 2.6, "eyeRight": 2.6, "brow": 2.2, "cheek": 1.4, "nose": 1.4, "mouth": 4.8}
OVERFLOW = 0.1  # fraction of the excess over the capacity that remains


class Ceiling(NamedTuple):
    """Upper limit of a shape's weight, as a curve of another shape's weight."""

    shape: str
    under: str
    curve: Curve


# The lips close only as far as the jaw is open (ARKit's mouthClose is sculpted onto the open jaw).
CEILINGS = [Ceiling("mouthClose", "jawOpen", [Key(0.0, 0.06, right=(0.3, 0.3)), Key(1.0, 1.0, left=(-0.35, -0.3))])]


def region(shape: str) -> str:
    """Region of a primary shape."""
    if shape.startswith(("eye", "lid")):
        return "eyeLeft" if shape.endswith("Left") else "eyeRight"
    for start, name in (("brow", "brow"), ("cheek", "cheek"), ("nose", "nose"), ("nostril", "nose")):
        if shape.startswith(start):
            return name
    return "mouth"


def cost(shape: str) -> float:
    """Capacity of its region that a primary shape uses at weight 1."""
    whole = shape in ("jawLeft", "jawRight", "mouthLeft", "mouthRight") or region(shape).startswith("eye")
    return 0.5 if shape.endswith(("Left", "Right")) and not whole else 1.0


def limit_curve(capacity: float) -> Curve:
    """A driven key from the sum of a region's weights to the factor on each: 1, decreasing beyond the capacity."""

    def factor(total: float) -> tuple[float, float]:
        spare = capacity * (1 - OVERFLOW)
        return OVERFLOW + spare / total, -spare / total**2

    sums = [capacity * multiple for multiple in (1.4, 2.2, 4.0, 8.0, 16.0)]
    start = Key(0.8 * capacity, 1.0, right=(0.25 * capacity, 0.0))
    curve = [start]
    for total, before, after in zip(sums, [start.x, *sums], [*sums[1:], sums[-1] + 1]):
        value, derivative = factor(total)
        left, right = (total - before) / 3, (after - total) / 3
        curve.append(Key(total, value, left=(-left, -left * derivative), right=(right, right * derivative)))
    return curve
