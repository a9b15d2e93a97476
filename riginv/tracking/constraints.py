"""What a user wants of the controls, resolved against a rig: which are free, held, static, dear, or tied in pairs."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from riginv.errors import InputError
from riginv.rig.interface import RigBackend
from riginv.tracking.control_names import ControlNames
from riginv.tracking.penalties import ControlPenalties


@dataclass(frozen=True)
class ControlConstraints:
    """What is wanted of a rig's controls.

    Attributes:
        free: whether a control is left to find, `(control,)`.
        held: what those that are not stand at, `(control,)`; neutral unless said.
        static: those that have one value for the clip, `(control,)`.
        penalties: among all controls.
    """

    free: Tensor
    held: Tensor
    static: Tensor
    penalties: ControlPenalties

    @property
    def only_of_solvers(self) -> str:
        """The key of a wish that a network alone cannot meet; empty where there is none."""
        penalties = self.penalties
        named = {
            "controls.weights": bool((penalties.penalty_scale != 1).any()),
            "controls.symmetric": len(penalties.symmetric) > 0,
            "controls.exclusive": len(penalties.exclusive) > 0,
        }
        return next((key for key, wished in named.items() if wished), "")

    def with_fixed(self, controls: Tensor, values: Tensor) -> "ControlConstraints":
        """The same with further controls `(control,)`, by mask, held at values `(control,)`."""
        return replace(self, free=self.free & ~controls, held=torch.where(controls, values, self.held))

    def penalties_of_free(self) -> ControlPenalties:
        """The penalties among the free controls alone, by their numbers among these; pairs with a held one are dropped."""
        place = torch.cumsum(self.free.long(), 0) - 1

        def kept(pairs: Tensor) -> Tensor:
            return place[pairs[self.free[pairs].all(dim=1)]]

        ours = self.penalties
        return replace(
            ours, penalty_scale=ours.penalty_scale[self.free], symmetric=kept(ours.symmetric), exclusive=kept(ours.exclusive)
        )


def resolve_constraints(rig: RigBackend, options: Mapping[str, Any]) -> ControlConstraints:
    """The constraints of a config's `controls`.

    Raises:
        InputError: a name, a value or a file is wrong; or no control is left free.
    """
    names = ControlNames(rig, options["unknown"])
    free = torch.zeros(len(rig.controls), dtype=torch.bool)
    free[names.fitting(options["activate"], "controls.activate")] = True
    free[names.fitting(options["freeze"], "controls.freeze")] = False
    penalty_scale, held = torch.ones(len(rig.controls)), rig.neutral_controls.clone()
    if options["mask"]:
        for number, weight in names.mask(Path(str(options["mask"]))).items():
            free[number] &= weight > 0
            penalty_scale[number] /= weight or 1.0
    for glob, weight in _mapping(options, "weights").items():
        _check_number(f"controls.weights.{glob}", weight, 0.0, 1e12)
        penalty_scale[names.fitting([glob], "controls.weights")] = float(weight)
    for glob, value in _mapping(options, "hold").items():
        for number in names.fitting([glob], "controls.hold"):
            control = rig.controls[number]
            _check_number(f"controls.hold.{glob}", value, control.lower, control.upper)
            free[number], held[number] = False, value
    static = torch.zeros_like(free)
    static[names.fitting(options["static"], "controls.static")] = True
    if not bool(free.any()):
        raise InputError("controls.activate, freeze, hold and mask leave no control free: there is nothing to find")
    pairs = {
        key: torch.tensor(names.pairs(options[key], f"controls.{key}"), dtype=torch.long).reshape(-1, 2)
        for key in ("symmetric", "exclusive")
    }
    for key in ("symmetric_mm2", "exclusive_mm2"):
        _check_number(f"controls.{key}", options[key], 0.0, 1e6)
    penalties = ControlPenalties(
        penalty_scale, pairs["symmetric"], pairs["exclusive"], options["symmetric_mm2"], options["exclusive_mm2"]
    )
    return ControlConstraints(free, held, static & free, penalties)


def _mapping(options: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = options[key]
    if value is not None and not isinstance(value, Mapping):
        raise InputError(f"controls.{key} is {value!r}, expected names, each with a value: controls.{key}={{jawOpen: 1}}")
    return {str(name): given for name, given in (value or {}).items()}


def _check_number(key: str, value: Any, least: float, most: float) -> None:
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        raise InputError(f"{key} is {value!r}, expected a number from {least:g} to {most:g}")
