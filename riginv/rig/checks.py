"""Checks of a rig's controls and mesh on construction."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from riginv.errors import InputError, printable

if TYPE_CHECKING:
    from riginv.rig.interface import Control


def _check_names(rig: str, controls: Sequence["Control"]) -> None:
    """Names are printed in terminals, tables and pages: no control characters or line breaks."""
    for what, name in (("it", rig), *(("a control", control.name) for control in controls)):
        if printable(name) != name:
            raise InputError(f"rig {rig!r:.80}: {what} is named {name!r:.80}, expected printable text: rename it")


def check_controls(rig: str, controls: Sequence["Control"]) -> None:
    """Raises InputError where controls are not valid."""
    _check_names(rig, controls)
    seen: set[str] = set()
    for control in controls:
        if control.name in seen:
            raise InputError(f"rig '{rig}': two controls are named '{control.name}'; names must be unique")
        seen.add(control.name)
        if not control.lower < control.upper:
            raise InputError(f"rig '{rig}': control '{control.name}' has lower {control.lower} >= upper {control.upper}")
        if not control.lower <= control.neutral <= control.upper:
            raise InputError(
                f"rig '{rig}': control '{control.name}' is neutral at {control.neutral}, outside its range "
                f"[{control.lower}, {control.upper}]"
            )
    if not controls:
        raise InputError(f"rig '{rig}' has no controls")


def check_mesh(rig: str, rest_vertices: Tensor, faces: Tensor) -> None:
    """Raises InputError where a rest mesh `(vertex, 3)` and faces `(face, 3)` are not valid."""
    if rest_vertices.ndim != 2 or rest_vertices.shape[1] != 3 or not len(rest_vertices):
        raise InputError(f"rig '{rig}': the rest mesh has shape {tuple(rest_vertices.shape)}, expected (vertex, 3)")
    if not torch.isfinite(rest_vertices).all():
        raise InputError(f"rig '{rig}': the rest mesh holds NaN or infinite coordinates")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"rig '{rig}': the faces have shape {tuple(faces.shape)}, expected (face, 3): triangulate them")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(rest_vertices)):
        raise InputError(
            f"rig '{rig}': the faces use vertices {int(faces.min())} to {int(faces.max())}, "
            f"the rest mesh has vertices 0 to {len(rest_vertices) - 1}"
        )
