"""Controls of DNA rigs, and their mapping to raw controls."""

from typing import Literal, NamedTuple

import numpy as np
from torch import Tensor

from riginv.errors import InputError, listed
from riginv.rig.interface import Control
from rigs.dna.format import DnaFile
from rigs.dna.format.layers import Behavior, Definition
from rigs.dna.logic import Logic
from rigs.dna.logic.conditions import input_ranges
from rigs.dna.logic.layout import Stage, put
from rigs.dna.logic.rotations import normalise

Kind = Literal["gui", "raw"]


class ControlSet(NamedTuple):
    """Controls of a rig.

    Attributes:
        controls: in the rig's order.
        mapping: from controls `(batch, control)` to raw controls `(batch, raw)`.
        notes: for the user.
    """

    controls: list[Control]
    mapping: Stage
    notes: list[str]


def control_set(file: DnaFile, logic: Logic, kind: Kind | None) -> ControlSet:
    """The controls of a file.

    Args:
        kind: `gui`, `raw`, or None: GUI controls where the file's table uses any, else raw ones.

    Raises:
        InputError: names are not unique, or GUI controls were requested and none has an effect.
    """
    definition = file.need(Definition)
    for what, names in (("GUI", definition.gui_controls), ("raw", definition.raw_controls)):
        _check_unique(file, what, names)
    lower, upper = input_ranges(file.need(Behavior).controls.table, logic.layout.gui)
    used = np.flatnonzero(upper > lower)
    if kind is None:
        kind = "gui" if len(used) else "raw"
    if kind == "raw":
        return _raw_controls(definition, logic)
    if not len(used):
        raise InputError(
            f"{file.path}: none of its {logic.layout.gui} GUI controls is used by its table: choose rig.controls=raw"
        )
    controls = [
        Control(definition.gui_controls[number], float(lower[number]), float(upper[number]), float(rest))
        for number, rest in zip(used, np.clip(0.0, lower[used], upper[used]))
    ]
    unused = [definition.gui_controls[number] for number in np.flatnonzero(~(upper > lower)).tolist()]
    shown = listed(name[:60] for name in unused)
    notes = [f"GUI controls that the table does not use are left out ({len(unused)}): {shown}"] if unused else []
    groups = logic.quaternions
    used_names = {control.name for control in controls}
    for control in _quaternion_controls(definition, groups):
        if control.name in used_names:
            raise InputError(f"{file.path}: a GUI and a raw control are both named '{control.name[:80]}': rename one of them")
        controls.append(control)
    if len(groups):
        notes.append(f"quaternions, which GUI controls do not reach, are controls too ({len(groups)} of them)")
    return ControlSet(controls, FromGui(logic, used), notes)


def _raw_controls(definition: Definition, logic: Logic) -> ControlSet:
    groups = logic.quaternions
    controls = [Control(name) for name in definition.raw_controls]
    for number, control in zip(groups.reshape(-1).tolist(), _quaternion_controls(definition, groups)):
        controls[number] = control
    notes = [f"raw controls that are quaternions, four each, are brought to length 1 ({len(groups)})"] if len(groups) else []
    return ControlSet(controls, FromRaw(logic), notes)


def _quaternion_controls(definition: Definition, groups: np.ndarray) -> list[Control]:
    """Four controls for each quaternion, at rest the identity."""
    names = definition.raw_controls
    return [
        Control(names[number], -1.0, 1.0, float(position == 3))
        for group in groups.tolist()
        for position, number in enumerate(group)
    ]


class FromRaw(Stage):
    """Raw controls with quaternions normalised."""

    quaternions: Tensor

    def __init__(self, logic: Logic) -> None:
        super().__init__()
        self.keep(quaternions=logic.quaternions)

    def forward(self, controls: Tensor) -> Tensor:
        """Controls `(batch, raw)` to raw controls `(batch, raw)`."""
        return with_quaternions(controls, self.quaternions, controls[:, self.quaternions.flatten()])


class FromGui(Stage):
    """GUI controls to raw controls by the table, then quaternions.

    Args:
        used: indices of the GUI controls that the table uses, `(gui,)`.
    """

    used: Tensor
    quaternions: Tensor

    def __init__(self, logic: Logic, used: np.ndarray) -> None:
        super().__init__()
        self.table, self.gui = logic.table, logic.layout.gui
        self.keep(used=used, quaternions=logic.quaternions)

    def forward(self, controls: Tensor) -> Tensor:
        """Controls `(batch, gui + 4 * quaternion)` to raw controls `(batch, raw)`."""
        count = len(self.used)
        gui = controls.new_zeros(len(controls), self.gui).index_copy(1, self.used, controls[:, :count])
        return with_quaternions(self.table(gui), self.quaternions, controls[:, count:])


def with_quaternions(raw: Tensor, groups: Tensor, values: Tensor) -> Tensor:
    """Raw controls `(batch, raw)` with quaternions `(batch, 4 * group)`, normalised."""
    if not len(groups):
        return raw
    return put(raw, groups.flatten(), normalise(values.unflatten(1, (-1, 4))).flatten(1))


def _check_unique(file: DnaFile, what: str, names: tuple[str, ...]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputError(f"{file.path}: two {what} controls are named {name[:80]!r}, expected unique names: rename one")
        seen.add(name)
