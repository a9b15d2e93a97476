"""Clips given as curves of a rig's controls: the meshes are poses of the rig, whose true controls are known."""

import numpy as np
import scipy
import torch

from riginv.clips.control_curves import Curves
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons, SourceFacts
from riginv.errors import InputError, listed
from riginv.rig.interface import RigBackend

SLACK = 1e-5  # of a control's range: values beyond the limits by rounding
MOVES = 1e-6  # relative change of an unknown column that is ignored


class PosedCurves(MeshSequence):
    """The poses of a rig at given control curves.

    Args:
        curves: as read from a file; values beyond a control's limits are clamped.
        rig: has the controls.
        options: `unknown` decides on controls that only the file or only the rig has.

    Raises:
        InputError: names do not match, or a value is no finite number.
    """

    def __init__(self, curves: Curves, rig: RigBackend, options: ReadingOptions) -> None:
        self.rig, notes = rig, list(curves.notes)
        controls = _controls(curves, rig, options, notes)
        self.controls = _within_limits(controls, curves.frame_numbers, rig, notes).float().numpy()
        self.motion = curves.motion
        self.in_rig_space = self.motion is None
        if self.motion is not None:
            if not np.abs(self.motion).max() < 1e9:
                raise InputError(f"{curves.path}: its motion reaches {np.abs(self.motion).max():.3g} mm or degrees: damaged")
            self.rotations = scipy.spatial.transform.Rotation.from_euler("xyz", self.motion[:, 3:], degrees=True).as_matrix()
            notes.append("the rigid motion beside the controls was applied")
        facts = SourceFacts(curves.format, rate_source=curves.rate_source, notes=tuple(notes))
        faces = Polygons.triangles(rig.faces.cpu().numpy())
        super().__init__(curves.path, curves.frame_numbers, len(rig.rest_vertices), faces, curves.fps, 1.0, "y", facts)

    @torch.no_grad()
    def read(self, start: int, stop: int) -> np.ndarray:
        assert self.controls is not None
        vertices = self.rig(torch.from_numpy(self.controls[start:stop]).to(self.rig.lower)).cpu().numpy()
        if self.motion is not None:
            vertices = vertices @ self.rotations[start:stop].transpose(0, 2, 1) + self.motion[start:stop, None, :3]
        return vertices.astype(np.float32)


def _controls(curves: Curves, rig: RigBackend, options: ReadingOptions, notes: list[str]) -> torch.Tensor:
    """Values `(frame, control)` of the rig's controls; neutral where the file does not name a control."""
    names = curves.names
    if names is None:
        if curves.values.shape[1] != len(rig.controls):
            raise InputError(
                f"{curves.path}: curves of {curves.values.shape[1]} controls without names, and rig '{rig.name}' has "
                f"{len(rig.controls)}: add their names as an array 'names'"
            )
        notes.append("its controls have no names: they were taken in the rig's order (an array 'names' names them)")
        names = list(rig.control_names)
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{curves.path}: control '{twice}' is there twice; each may be there once")
    column = {name: number for number, name in enumerate(names)}
    _check_names(curves, column, rig, options, notes)
    values = rig.neutral_controls.cpu().double().repeat(len(curves.values), 1)
    for number, name in enumerate(rig.control_names):
        if name in column:
            curves.check_column(column[name], name)
            values[:, number] = torch.from_numpy(curves.values[:, column[name]])
    return values


def _check_names(curves: Curves, column: dict[str, int], rig: RigBackend, options: ReadingOptions, notes: list[str]) -> None:
    missing = [name for name in rig.control_names if name not in column]
    if len(missing) == len(rig.controls):
        raise InputError(
            f"{curves.path}: none of its columns ({listed(column, 4)}) is a control of rig '{rig.name}' "
            f"({listed(rig.control_names, 4)}), and it has no timecodes as a Live Link Face recording has"
        )
    if missing and not options.accepts_missing:
        raise InputError(
            f"{curves.path}: does not name {len(missing)} of the {len(rig.controls)} controls of rig '{rig.name}', the first: "
            f"{', '.join(missing[:4])}; reading.unknown=ignore_missing leaves them at neutral"
        )
    if missing:
        notes.append(f"controls that it does not name stay at neutral: {listed(missing)}")
    known = set(rig.control_names)
    new = [name for name in column if name not in known]
    moving = [name for name in new if _moves(curves, column[name])]
    if moving and not options.accepts_new:
        more = f" (nor {len(moving) - 1} more of its columns)" if len(moving) > 1 else ""
        raise InputError(
            f"{curves.path}: '{moving[0]}' moves, and rig '{rig.name}' has no such control{more}; reading.unknown=ignore_new "
            f"leaves it out"
        )
    if new:
        notes.append(f"columns that are no controls of the rig were left out: {listed(new)}")


def _moves(curves: Curves, column: int) -> bool:
    """Whether a column holds finite numbers that change."""
    values = curves.values[:, column]
    return bool(np.isfinite(values).all() and np.ptp(values) > MOVES * max(1.0, np.abs(values).max()))


def _within_limits(controls: torch.Tensor, frames: np.ndarray, rig: RigBackend, notes: list[str]) -> torch.Tensor:
    lower, upper = rig.lower.cpu().double(), rig.upper.cpu().double()
    beyond = torch.maximum(lower - controls, controls - upper) / (upper - lower)
    if bool((beyond > SLACK).any()):
        row, column = divmod(int(beyond.argmax()), beyond.shape[1])
        name = rig.control_names[column]
        notes.append(
            f"{int((beyond > SLACK).sum()):,} values lie beyond their controls' limits and were brought back to them, the "
            f"farthest '{name}' at {float(controls[row, column]):.4g} in frame {int(frames[row])} "
            f"({float(lower[column]):g} to {float(upper[column]):g})"
        )
    return controls.clamp(lower, upper)
