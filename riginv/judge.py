"""Judging by the true rig: errors are measured on what it makes of the controls, never on a network's own surrogate."""

from collections.abc import Callable

import torch
from torch import Tensor

from riginv.data.mesh_sets import MeshSet
from riginv.errors import InputError
from riginv.metrics import VertexError, roughness
from riginv.rig import RigBackend

PIECE = 128  # meshes at a time


@torch.no_grad()
def judge_inverse(invert: Callable[[Tensor], Tensor], true_rig: RigBackend, mesh_set: MeshSet) -> dict[str, float]:
    """How well controls found for meshes bring these back.

    Args:
        invert: meshes `(batch, vertex, 3)`, mm, to controls `(batch, control)`.

    Returns:
        By `SET/key`: the errors of `VertexError`, `neutral_mean_vertex_error_mm` (what predicting neutral would cost), and
        for a clip `roughness`.
    """
    found, neutral, curves = VertexError(), VertexError(), []
    for _, vertices in mesh_set.pieces(PIECE):
        controls = invert(vertices)
        curves.append(controls)
        found.update(true_rig(controls), vertices)
        neutral.update(true_rig.rest_vertices.expand_as(vertices), vertices)
    more = {"roughness": roughness(torch.cat(curves))} if mesh_set.fps else {}
    return _named(mesh_set.name, found, neutral, more)


@torch.no_grad()
def judge_rig(rig: RigBackend, true_rig: RigBackend, controls: Tensor, name: str) -> dict[str, float]:
    """How far a rig, such as a surrogate, lies from the true rig on the same controls `(pose, control)`.

    Returns:
        By `NAME/key`: the errors of `VertexError`, and `neutral_mean_vertex_error_mm`.
    """
    found, neutral = VertexError(), VertexError()
    for piece in controls.split(PIECE):
        expected = true_rig(piece)
        found.update(rig(piece), expected)
        neutral.update(true_rig.rest_vertices.expand_as(expected), expected)
    return _named(name, found, neutral)


def check_same_controls(rig: RigBackend, true_rig: RigBackend) -> None:
    """Raises InputError where a rig cannot be judged by another: their controls or their vertices differ."""
    if rig.control_names != true_rig.control_names:
        ours, theirs = set(rig.control_names), set(true_rig.control_names)
        differing = sorted(ours ^ theirs)[:3] or ["their order"]
        raise InputError(
            f"rig '{rig.name}' with {len(rig.controls)} controls cannot be judged by '{true_rig.name}' with "
            f"{len(true_rig.controls)}: {', '.join(differing)} differ"
        )
    if len(rig.rest_vertices) != len(true_rig.rest_vertices):
        raise InputError(
            f"rig '{rig.name}' has {len(rig.rest_vertices)} vertices, '{true_rig.name}' has {len(true_rig.rest_vertices)}: "
            f"they are not the same mesh"
        )


def _named(name: str, found: VertexError, neutral: VertexError, more: dict[str, float] | None = None) -> dict[str, float]:
    values = {key: float(value) for key, value in found.compute().items()}
    values["neutral_mean_vertex_error_mm"] = float(neutral.compute()["mean_vertex_error_mm"])
    return {f"{name}/{key}": value for key, value in {**values, **(more or {})}.items()}
