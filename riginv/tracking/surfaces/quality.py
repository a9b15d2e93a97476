"""How well a state explains a scan: distances both ways, what was seen, what was not explained."""

from typing import NamedTuple

import numpy as np

from riginv.tracking.surfaces.fitting import State, SurfaceFit
from riginv.tracking.surfaces.matching import Pairs, Target, match

SCALE_MM = 3.0  # at which a distance is cut off, softly, where states are compared
EXPLAINED_MM = 2.0  # up to which a point of the scan counts as explained
SEEN_MM = 5.0  # up to which the scan has seen a point of the rig
DEGREES = 60.0


class Quality(NamedTuple):
    """How well a state explains a scan.

    Attributes:
        objective: robust mean squared distance of both ways and the prior's cost, mm^2: what states are compared by.
        scan_mm: mean distance of the scan's explained points from the rig.
        rig_mm: mean distance of the rig's seen samples from the scan.
        seen: the fraction of the rig's outer samples that the scan has seen.
        explained: the fraction of the scan's points that the rig explains, those beyond the rig's border left out.
        unexplained: which of the target's points it does not explain, `(sample,)`.
    """

    objective: float
    scan_mm: float
    rig_mm: float
    seen: float
    explained: float
    unexplained: np.ndarray


def quality(fit: SurfaceFit, target: Target, state: State) -> Quality:
    """How well a state explains a scan."""
    posed = fit.surface.posed(fit.coefficients(state.units))
    pairs = match(fit.surface, posed, target, state.motion, SCALE_MM, DEGREES)
    return judged(fit, pairs, state)


def judged(fit: SurfaceFit, pairs: Pairs, state: State) -> Quality:
    """The same, of pairs that were matched at `SCALE_MM` and `DEGREES`."""
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
