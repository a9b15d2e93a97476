"""Twists and swings: joints with a part of the rotation of a quaternion control."""

import numpy as np
import torch
from torch import Tensor

from rigs.dna.format.later_layers import Twist, TwistsAndSwings
from rigs.dna.logic.layout import Layout, Stage
from rigs.dna.logic.rotations import conjugate, multiply, normalise, to_identity, twist_of


class TwistedJoints(Stage):
    """Rotations of the joints of twists and swings, which override those of joint groups.

    Args:
        joints: indices of the evaluated joints, `(joint,)`.

    Attributes:
        positions: indices of the affected joints among those, `(twisted,)`.

    Raises:
        InputError: an entry is damaged.
    """

    positions: Tensor
    controls: Tensor
    weights: Tensor

    def __init__(self, layout: Layout, entries: TwistsAndSwings, joints: np.ndarray, count: int) -> None:
        super().__init__()
        index_of = {int(joint): number for number, joint in enumerate(joints)}
        swung = {tuple(swing.controls.tolist()) for swing in entries.swings}
        kinds = [("twist", twist) for twist in entries.twists] + [("swing", swing) for swing in entries.swings]
        rows: dict[int, tuple] = {}
        for number, (kind, entry) in enumerate(kinds):
            _check(layout, f"{kind} {number}", entry, count)
            controls = tuple(entry.controls.tolist())
            form = "swing" if kind == "swing" else "inverse" if controls in swung else "twist"
            for joint, weight in zip(entry.joints.tolist(), entry.weights.tolist()):
                if joint in index_of:
                    rows[joint] = (index_of[joint], controls, weight, int(entry.axis), form)
        found = list(rows.values())
        self.keep(
            positions=np.array([row[0] for row in found], dtype=np.int64),
            controls=np.array([row[1] for row in found], dtype=np.int64).reshape(-1, 4),
            weights=np.array([row[2] for row in found], dtype=np.float64),
        )
        self.axes = [row[3] for row in found]
        self.forms = [row[4] for row in found]

    def forward(self, controls: Tensor) -> Tensor:
        """All controls `(batch, control)` to quaternions `(batch, twisted, 4)`."""
        given = controls.index_select(1, self.controls.flatten()).unflatten(1, (-1, 4))
        parts = []
        for number, (axis, form) in enumerate(zip(self.axes, self.forms)):
            rotation, weight = given[:, number], self.weights[number].to(controls)
            twist = twist_of(rotation, axis)
            if form == "swing":
                swing = normalise(multiply(rotation, conjugate(twist)))
                parts.append(multiply(conjugate(twist), to_identity(conjugate(swing), weight)))
            else:
                parts.append(to_identity(conjugate(twist) if form == "inverse" else twist, weight))
        return torch.stack(parts, dim=1) if parts else given.new_zeros(len(given), 0, 4)


def _check(layout: Layout, what: str, entry: Twist, joints: int) -> None:
    layout.check_lengths(what, joints=len(entry.joints), weights=len(entry.weights))
    layout.check(what, entry.joints, joints, "joints")
    layout.check_controls(what, entry.controls)
    layout.check_finite(what, entry.weights)
    if len(entry.controls) != 4 or entry.axis > 2:
        raise layout.wrong(f"{what} has {len(entry.controls)} controls and axis {entry.axis}, expected 4 and 0 to 2")
