"""Evaluation on the true rig: errors are those of its meshes at the predicted controls, never those of a surrogate."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any

import torch
from torch import Tensor

from riginv.config.building import ClassSpec
from riginv.errors import InputError
from riginv.evaluation.control_accuracy import control_accuracy
from riginv.geometry.distances import mean_distance
from riginv.meshes.metrics import roughness
from riginv.meshes.rendering import Pair
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import MeshSet

BATCH_SIZE = 128  # meshes at a time


@dataclass(frozen=True)
class EvaluationResult:
    """The result on one evaluation set.

    Attributes:
        metrics: by `SET/key`: the errors of `VertexError`, `neutral_mean_vertex_error_mm` (the error of neutral controls),
            for a clip `roughness`, and the accuracy of the controls; `evaluate_model` adds the optimum.
        errors_mm: the mean vertex error of each mesh, `(mesh,)`.
        meshes: the set.
        rig: the rig that made the meshes: the true rig, or the surrogate being evaluated.
        controls: the predicted controls, `(mesh, control)`.
    """

    metrics: dict[str, Any]
    errors_mm: Tensor
    meshes: MeshSet
    rig: RigBackend
    controls: Tensor

    def worst_and_median(self) -> list[Pair]:
        """The worst and the median mesh of the set, to look at."""
        order = self.errors_mm.argsort(descending=True).tolist()
        name = self.meshes.name.replace("_", " ")
        return [self._pair(order[0], f"{name}, worst"), self._pair(order[len(order) // 2], f"{name}, median")]

    def with_accuracy(self, effects: ControlEffects) -> "EvaluationResult":
        """The same with the accuracy of the controls, where the set has the true ones."""
        true = self.meshes.controls
        if true is None:
            return self
        accuracy = control_accuracy(effects, self.controls, true, self.meshes.fps is not None)
        figures = {f"{self.meshes.name}/{key}": value for key, value in accuracy.as_json().items()}
        return replace(self, metrics={**self.metrics, **figures})

    @torch.no_grad()
    def _pair(self, row: int, label: str) -> Pair:
        return Pair(label, self.meshes.vertices(row, row + 1)[0], self.rig(self.controls[row : row + 1])[0])


def evaluate_inverse(invert: Callable[[Tensor], Tensor], true_rig: RigBackend, meshes: MeshSet) -> EvaluationResult:
    """Evaluate an inverse: errors of the true rig's meshes at the controls that it predicts.

    Args:
        invert: meshes `(batch, vertex, 3)`, mm, to controls `(batch, control)`.
    """
    return _evaluate(true_rig, meshes, lambda start, vertices: invert(vertices))


def evaluate_controls(true_rig: RigBackend, meshes: MeshSet, controls: Tensor) -> EvaluationResult:
    """Evaluate controls `(mesh, control)` predicted for the meshes of a set: errors of the true rig's meshes at them."""
    return _evaluate(true_rig, meshes, lambda start, vertices: controls[start : start + len(vertices)])


def evaluate_rig(rig: RigBackend, poses: MeshSet) -> EvaluationResult:
    """Evaluate a rig, such as a surrogate: its vertex errors at the controls of poses of the true rig."""
    assert poses.controls is not None
    return evaluate_controls(rig, poses, poses.controls)


@torch.no_grad()
def _evaluate(rig: RigBackend, meshes: MeshSet, controls_of: Callable[[int, Tensor], Tensor]) -> EvaluationResult:
    from riginv.meshes.vertex_error import VertexError  # torchmetrics takes two seconds, and inverting a clip needs none

    found, neutral, errors, curves = VertexError(), VertexError(), [], []
    for start, vertices in meshes.batches(BATCH_SIZE):
        controls = controls_of(start, vertices)
        results = rig(controls)
        known = meshes.known(start, start + len(vertices))
        found.update(results, vertices, known)
        neutral.update(rig.rest_vertices.expand_as(vertices), vertices, known)
        errors.append(mean_distance(results, vertices, known))
        curves.append(controls)
    controls = torch.cat(curves)
    values = {key: float(value) for key, value in found.compute().items()}
    values["neutral_mean_vertex_error_mm"] = float(neutral.compute()["mean_vertex_error_mm"])
    if meshes.fps and not math.isnan(rough := roughness(controls, meshes.frame_numbers)):
        values["roughness"] = rough
    metrics = {f"{meshes.name}/{key}": value for key, value in values.items()}
    return EvaluationResult(metrics, torch.cat(errors), meshes, rig, controls)


def make_true_rig(spec: ClassSpec[RigBackend], rig: RigBackend) -> RigBackend:
    """The rig that evaluates `rig`; a class with an argument `twin_of` receives the rig that it stands for.

    Raises:
        InputError: it cannot be built, or has other controls or vertices than the rig.
    """
    takes_source = "twin_of" in signature(spec.target_class).parameters
    true_rig = spec.build(**({"twin_of": rig.true_rig()} if takes_source else {}))
    check_same_controls(rig, true_rig)
    return true_rig


def check_same_controls(rig: RigBackend, true_rig: RigBackend) -> None:
    """Raises InputError where two rigs have different controls or vertices."""
    if rig.control_names != true_rig.control_names:
        ours, theirs = set(rig.control_names), set(true_rig.control_names)
        differing = sorted(ours ^ theirs)[:3] or ["their order"]
        raise InputError(
            f"rig '{rig.name}' with {len(rig.controls)} controls cannot be evaluated on '{true_rig.name}' with "
            f"{len(true_rig.controls)}: {', '.join(differing)} differ"
        )
    if len(rig.rest_vertices) != len(true_rig.rest_vertices):
        raise InputError(
            f"rig '{rig.name}' has {len(rig.rest_vertices)} vertices, '{true_rig.name}' has {len(true_rig.rest_vertices)}: "
            f"they are not the same mesh"
        )
