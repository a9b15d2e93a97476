"""Drivers of shapes: controls, in-betweens of controls, and products of these."""

import functools
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from riginv.geometry.neighbours import evenly
from riginv.rig.interface import LinearRig

HATS = ((0.0, 0.5, 1.0), (0.0, 0.25, 0.5), (0.25, 0.5, 0.75), (0.5, 0.75, 1.0))  # in-betweens tried with solved controls
PEAKS = (25, 50, 75)  # %, of those tried with known controls, with all knots
INBETWEEN = re.compile(r"(.+?)(\d\d)")
SIMPLER = 0.98  # likelihood of a driver with one factor more
ELSEWHERE = 0.85  # likelihood of a shape where one of its factors does not move the mesh
MOVES = 0.05  # of a control's largest displacement: a vertex moves with it
ACTIVE, MIN_PEAK = 0.05, 0.15  # of a factor in a frame, of a product in its best frame
FRAMES = 700  # looked at for products
# The strongest factors of a frame that are looked at for products of two, of three, and so on, and the products that are kept:
# true controls tell them apart; among more of them solved controls lead to more wrong ones.
FACTORS, MAX_DRIVERS = (12, 12, 12, 12, 12), 10000
FACTORS_KNOWN, MAX_DRIVERS_KNOWN = (60, 40, 16, 12, 12), 30000


@dataclass(frozen=True)
class Driver:
    """A product of factors.

    Attributes:
        factors: indices of the factors.
        name: their names joined by underscores, as `rig=shapes` names combinations.
    """

    factors: tuple[int, ...]
    name: str


def numbered(drivers: Sequence[Driver]) -> list[Driver]:
    """The drivers with names of their own: of in-betweens with one peak (`nose50`) the second is called `nose50-2`."""
    count: Counter[str] = Counter()
    found = []
    for driver in drivers:
        count[driver.name] += 1
        number = count[driver.name]
        found.append(replace(driver, name=f"{driver.name}-{number}") if number > 1 else driver)
    return found


class Factors:
    """The values that shapes may be driven by: each side of each control, in-betweens of the rig, in-betweens that it may lack.

    Args:
        known: whether the controls of the clip are known, so that more may be tried.

    Attributes:
        names: of the factors; the lower side of a two-sided control is `-NAME`.
        owners: the control of each factor.
        hats: three knots of each in-between that the rig may lack, by factor.
    """

    def __init__(self, rig: LinearRig, known: bool = False) -> None:
        self.rig, self.known = rig, known
        lower, upper, neutral = rig.lower.tolist(), rig.upper.tolist(), rig.neutral_controls.tolist()
        control_of = {name: number for number, name in enumerate(rig.control_names)}
        self.sides = [(number, 1) for number in range(len(neutral)) if upper[number] > neutral[number]]
        self.sides += [(number, -1) for number in range(len(neutral)) if lower[number] < neutral[number]]
        self.names = [("" if sign > 0 else "-") + rig.control_names[number] for number, sign in self.sides]
        self.owners = [number for number, _ in self.sides]
        self.coefficients = []
        for row, name in enumerate(rig.coefficient_names):
            found = INBETWEEN.fullmatch(name)
            if found and found[1] in control_of and name not in control_of:
                self.coefficients.append(row)
                self.names.append(name)
                self.owners.append(control_of[found[1]])
        self.hats: dict[int, tuple[int, tuple[float, float, float]]] = {}
        taken = {*rig.control_names, *rig.coefficient_names}
        for side in range(len(self.sides)):
            given = [peak for peak in range(1, 100) if f"{self.names[side]}{peak:02d}" in taken]
            for hat in _hats(given) if known else [hat for hat in HATS if round(100 * hat[1]) not in given]:
                self.hats[len(self.names)] = (side, hat)
                self.names.append(f"{self.names[side]}{round(100 * hat[1]):02d}")
                self.owners.append(self.owners[side])

    def values(self, controls: Float[Tensor, "frame control"]) -> Float[Tensor, "frame factor"]:
        """The factors `(frame, factor)` in [0, 1] of controls `(frame, control)`."""
        rig, away = self.rig, controls - self.rig.neutral_controls.to(controls)
        up, down = (rig.upper - rig.neutral_controls).to(controls), (rig.neutral_controls - rig.lower).to(controls)
        sides = [(away[:, n] / up[n] if sign > 0 else -away[:, n] / down[n]).clamp_min(0) for n, sign in self.sides]
        found = torch.stack(sides, dim=1)
        between = [rig.coefficients(controls)[:, self.coefficients]] if self.coefficients else []
        hats = [_hat(found[:, side], hat)[:, None] for side, hat in self.hats.values()]
        return torch.cat([found, *between, *hats], dim=1)

    def pose(self, driver: Driver) -> Float[Tensor, "1 control"]:
        """The controls `(1, control)` at which a driver is 1."""
        rig, pose = self.rig, self.rig.neutral_controls[None].clone()
        for factor in driver.factors:
            number, name = self.owners[factor], self.names[factor]
            end = rig.lower[number] if name.startswith("-") else rig.upper[number]
            digits = None if factor < len(self.sides) else INBETWEEN.fullmatch(name)
            pose[0, number] = torch.lerp(rig.neutral_controls[number], end, int(digits[2]) / 100 if digits else 1.0)
        return pose

    def neighbours(self, driver: Driver) -> list[int]:
        """The rig's in-betweens (rows of its basis) of the control that an in-between belongs to; they make room for it."""
        if driver.factors[0] not in self.hats:
            return []
        first, owner = len(self.sides), self.owners[driver.factors[0]]
        return [row for number, row in enumerate(self.coefficients) if self.owners[first + number] == owner]

    def products(self, values: Float[Tensor, "frame factor"], drivers: list[Driver]) -> Float[Tensor, "frame driver"]:
        """The drivers `(frame, driver)` from the values of the factors."""
        most = max((len(driver.factors) for driver in drivers), default=1)
        one = torch.cat([values, values.new_ones(len(values), 1)], dim=1)
        index = torch.tensor([[*driver.factors, *[values.shape[1]] * (most - len(driver.factors))] for driver in drivers])
        result = one[:, index[:, 0]]
        for column in index.T[1:]:
            result = result * one[:, column]
        return result

    def candidates(self, values: Float[Tensor, "frame factor"], most: int) -> list[Driver]:
        """In-betweens, and products of up to `most` factors, that a clip uses and for which the rig has no shape."""
        plain = range(len(self.sides) + len(self.coefficients))
        limits, kept = (FACTORS_KNOWN, MAX_DRIVERS_KNOWN) if self.known else (FACTORS, MAX_DRIVERS)
        found: dict[tuple[int, ...], None] = {(number,): None for number in self.hats}
        for row in values[evenly(FRAMES, len(values))][:, list(plain)]:
            active = (row > ACTIVE).nonzero()[:, 0]
            active = active[row[active].argsort(descending=True)].tolist()
            for count, strongest in zip(range(2, most + 1), limits):
                found.update(dict.fromkeys(itertools.combinations(sorted(active[:strongest]), count)))
        taken = {tuple(sorted(name.split("_"))) for name in self.rig.coefficient_names}
        drivers = []
        for factors in found:
            name = "_".join(self.names[number] for number in factors)
            owners = {self.owners[number] for number in factors}
            if len(owners) == len(factors) and tuple(sorted(name.split("_"))) not in taken:
                drivers.append(Driver(factors, name))
        signals = self.products(values, drivers) if drivers else values[:, :0]
        strength = torch.where(signals.amax(dim=0) >= MIN_PEAK, signals.square().sum(dim=0), 0.0)
        order = strength.argsort(descending=True, stable=True)[:kept].tolist()
        return [drivers[number] for number in order if strength[number] > 0]

    @functools.cached_property
    @torch.no_grad()
    def extents(self) -> Float[Tensor, "factor vertex"]:
        """The displacement of each vertex by the control of each factor, as a fraction of its largest."""
        rig = self.rig
        poses = rig.neutral_controls.repeat(len(self.sides), 1)
        for row, (number, sign) in enumerate(self.sides):
            poses[row, number] = rig.upper[number] if sign > 0 else rig.lower[number]
        lengths = torch.cat([(rig(pose[None]) - rig.rest_vertices).norm(dim=2) for pose in poses])
        largest = lengths.amax(dim=1, keepdim=True)
        found = torch.where(largest > 0, lengths / largest.clamp_min(1e-6), 1.0)  # some move the mesh with others alone
        by_control = {number: row for row, (number, _) in reversed(list(enumerate(self.sides)))}
        return found[[row if row < len(self.sides) else by_control[owner] for row, owner in enumerate(self.owners)]]

    def likelihoods(self, drivers: list[Driver], voters: Int[Tensor, " voter"]) -> Float[Tensor, "driver voter"]:
        """The prior probability of each driver at each vertex: higher for few factors that all move the mesh there."""
        moved, found = (self.extents[:, voters] / MOVES).clamp_max(1), torch.empty(len(drivers), len(voters))
        for number, driver in enumerate(drivers):
            least = moved[list(driver.factors)].amin(dim=0)
            found[number] = (ELSEWHERE + (1 - ELSEWHERE) * least) * SIMPLER ** (len(driver.factors) - 1)
        return found

    def nearness(self, driver: Driver) -> Float[Tensor, " vertex"]:
        """How much the controls of a driver move each vertex: the squared geometric mean of the fractions of their largest."""
        return self.extents[list(driver.factors)].clamp_min(1e-6).log().mean(dim=0).mul(2).exp()

    def is_simpler(self, one: Driver, other: Driver) -> bool:
        """Whether a driver has a part of the controls of another alone, or the same ones with fewer in-betweens."""
        first, second = ({self.owners[factor] for factor in driver.factors} for driver in (one, other))
        counts = [sum(factor >= len(self.sides) for factor in driver.factors) for driver in (one, other)]
        return first < second or (first == second and counts[0] < counts[1])


def _hats(given: list[int]) -> list[tuple[float, float, float]]:
    """Knots of the in-betweens that a control may lack beside given peaks, %; none reaches across one of these."""
    knots = sorted({0, *PEAKS, *given, 100})
    found = itertools.combinations(knots, 3)
    free = [hat for hat in found if hat[1] not in given and not any(hat[0] < peak < hat[2] for peak in given)]
    return [(left / 100, middle / 100, right / 100) for left, middle, right in free]


def _hat(values: Tensor, hat: tuple[float, float, float]) -> Tensor:
    left, middle, right = hat
    return torch.minimum((values - left) / (middle - left), (right - values) / (right - middle)).clamp_min(0)
