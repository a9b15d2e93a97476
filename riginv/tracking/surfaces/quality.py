"""The quality of a fit to a scan: distances in both directions, coverage, unexplained points."""

from typing import NamedTuple

import numpy as np

from riginv.tracking.surfaces.fitting import State, SurfaceFit
from riginv.tracking.surfaces.matching import Pairs, Target, match

SCALE_MM = 1.0  # at which distances saturate in the objective: with 3, what the rig cannot make decides
EXPLAINED_MM = 2.0  # distance of explained points of the scan from the rig
SEEN_MM = 5.0  # distance of covered points of the rig from the scan
DEGREES = 60.0


class Quality(NamedTuple):
    """The quality of a state as a fit to a scan.

    Attributes:
        objective: robust mean squared distance in both directions plus the prior's cost, mm^2, to compare states.
        scan_mm: mean distance of the scan's explained points from the rig.
        rig_mm: mean distance of the rig's covered samples from the scan.
        seen: the fraction of the rig's outer samples that the scan covers.
        explained: the fraction of the scan's points that the rig explains, without points beyond the rig's border.
        unexplained: whether each of the target's points is unexplained, `(sample,)`.
    """

    objective: float
    scan_mm: float
    rig_mm: float
    seen: float
    explained: float
    unexplained: np.ndarray


def quality(fit: SurfaceFit, target: Target, state: State) -> Quality:
    """The quality of a state as a fit to a scan."""
    posed = fit.posed(state)
    pairs = match(fit.surface, posed, target, state.motion, SCALE_MM, DEGREES)
    return quality_of_pairs(fit, pairs, state)


def quality_of_pairs(fit: SurfaceFit, pairs: Pairs, state: State) -> Quality:
    """The same for pairs that were matched with `SCALE_MM` and `DEGREES`."""
    count, distance, good = pairs.from_rig, pairs.distance, pairs.weights > 0
    soft = distance**2 / (1 + (distance / SCALE_MM) ** 2)
    of_rig, of_scan = slice(0, count), slice(count, None)
    cost = np.where(good[of_rig], soft[of_rig], 0).sum()
    cost += np.where(good[of_scan] | pairs.on_border[of_scan], soft[of_scan], SCALE_MM**2).sum()
    seen = good[of_rig] & (distance[of_rig] < SEEN_MM)
    inside = ~pairs.on_border[of_scan]
    explained = good[of_scan] & (distance[of_scan] < EXPLAINED_MM)
    return Quality(
        float(0.5 * cost / len(distance) + fit.prior.cost(state.units[None])[0]),
        _mean(distance[of_scan][explained]),
        _mean(distance[of_rig][seen]),
        float(seen.mean()),
        float(explained[inside].mean()) if inside.any() else 0.0,
        inside & ~explained,
    )


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")
