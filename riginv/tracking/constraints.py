"""Constraints on a rig's controls: which are free, fixed, static, penalised, or tied in pairs."""

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.tracking.control_names import ControlNames
from riginv.tracking.options import ControlOptions
from riginv.tracking.penalties import ControlPenalties


@dataclass(frozen=True)
class ControlConstraints:
    """Constraints on a rig's controls.

    Attributes:
        free: whether a control is free, `(control,)`.
        values: of the controls that are not free, `(control,)`; neutral unless given.
        static: whether a free control has one value for the whole clip, `(control,)`.
        penalties: over all controls.
    """

    free: Tensor
    values: Tensor
    static: Tensor
    penalties: ControlPenalties

    @property
    def solver_only(self) -> str:
        """The key of a constraint that a network alone cannot meet, or an empty text."""
        penalties = self.penalties
        used = {
            "controls.weights": bool((penalties.penalty_scale != 1).any()),
            "controls.symmetric": len(penalties.symmetric) > 0,
            "controls.exclusive": len(penalties.exclusive) > 0,
        }
        return next((key for key, is_used in used.items() if is_used), "")

    def with_fixed(self, controls: Tensor, values: Tensor) -> "ControlConstraints":
        """The same with further controls fixed: a mask `(control,)` and values `(control,)`."""
        return replace(self, free=self.free & ~controls, values=torch.where(controls, values, self.values))

    def penalties_of_free(self) -> ControlPenalties:
        """The penalties over the free controls alone, by their indices; pairs with a fixed control are dropped."""
        index = torch.cumsum(self.free.long(), 0) - 1

        def among_free(pairs: Tensor) -> Tensor:
            return index[pairs[self.free[pairs].all(dim=1)]]

        penalties = self.penalties
        return replace(
            penalties,
            penalty_scale=penalties.penalty_scale[self.free],
            symmetric=among_free(penalties.symmetric),
            exclusive=among_free(penalties.exclusive),
        )


def resolve_constraints(rig: RigBackend, options: ControlOptions) -> ControlConstraints:
    """The constraints of options for a rig.

    Raises:
        InputError: a name, a value or a file is wrong; or no control is free.
    """
    names = ControlNames(rig, options.unknown)
    free = torch.zeros(len(rig.controls), dtype=torch.bool)
    free[names.matching(options.activate, "controls.activate")] = True
    free[names.matching(options.freeze, "controls.freeze")] = False
    penalty_scale, values = torch.ones(len(rig.controls)), rig.neutral_controls.clone()
    if options.mask:
        for number, weight in names.mask(Path(options.mask)).items():
            free[number] &= weight > 0
            penalty_scale[number] /= weight or 1.0
    for glob, weight in (options.weights or {}).items():
        penalty_scale[names.matching([glob], "controls.weights")] = float(weight)
    for glob, value in (options.hold or {}).items():
        for number in names.matching([glob], "controls.hold"):
            control = rig.controls[number]
            if not control.lower <= value <= control.upper:
                raise InputError(
                    f"controls.hold.{glob} is {value!r}, expected a number from {control.lower:g} to {control.upper:g}"
                )
            free[number], values[number] = False, value
    static = torch.zeros_like(free)
    static[names.matching(options.static, "controls.static")] = True
    if not bool(free.any()):
        raise InputError("controls.activate, freeze, hold and mask leave no control free: there is nothing to find")
    symmetric, exclusive = (
        torch.tensor(names.pairs(pairs, key), dtype=torch.long).reshape(-1, 2)
        for pairs, key in ((options.symmetric, "controls.symmetric"), (options.exclusive, "controls.exclusive"))
    )
    penalties = ControlPenalties(penalty_scale, symmetric, exclusive, options.symmetric_mm2, options.exclusive_mm2)
    return ControlConstraints(free, values, static & free, penalties)
