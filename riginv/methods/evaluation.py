"""Evaluation of one method on one set: errors, roughness, sparsity and time."""

import time
from dataclasses import asdict, dataclass
from typing import Any

from torch import Tensor

from riginv.errors import InputError
from riginv.evaluation.optimum import Optimum
from riginv.evaluation.results import evaluate_controls
from riginv.meshes.metrics import nonzero_controls
from riginv.methods.base import Method
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import MeshSet

ACCURACY = ("control_precision", "control_recall", "control_error_weighted")


@dataclass(frozen=True)
class Row:
    """The results of a method on a set; the fields but the optimum's are the columns of compare.csv.

    None: of roughness, where the set is no clip; of the optimum and of the controls, where these are not known.
    """

    method: str
    set: str
    mean_vertex_error_mm: float
    max_vertex_error_mm: float
    roughness: float | None
    nonzero_controls: float
    ms_per_frame: float
    training_seconds: float
    optimum_ratio: float | None
    optimum_mm: float | None
    control_precision: float | None = None
    control_recall: float | None = None
    control_error_weighted: float | None = None
    optimum_is_bound: float | None = None  # 1: the optimum is an upper bound, so that the ratio is a lower one

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


class Clocked(MeshSet):
    """A set that measures the time it takes to make its meshes, and does not expose the controls that made them."""

    def __init__(self, meshes: MeshSet) -> None:
        super().__init__(meshes.name, meshes.fps, frame_numbers=meshes.frame_numbers)
        self.meshes, self.seconds = meshes, 0.0

    def __len__(self) -> int:
        return len(self.meshes)

    def vertices(self, start: int, stop: int) -> Tensor:
        began = time.perf_counter()
        result = self.meshes.vertices(start, stop)
        self.seconds += time.perf_counter() - began
        return result


def evaluated_row(
    name: str,
    method: Method,
    true_rig: RigBackend,
    meshes: MeshSet,
    training_seconds: float,
    optimum: Optimum | None = None,
    effects: ControlEffects | None = None,
) -> Row:
    """Invert a set with a method, and evaluate its controls on the true rig.

    Args:
        optimum: the best possible on some of the meshes, where it is known.
        effects: of the true rig's controls: the accuracy of controls is measured where the set has the true ones.

    Raises:
        InputError: the method gives controls that are not numbers, of another shape, or outside the rig's limits.
    """
    clocked = Clocked(meshes)
    began = time.perf_counter()
    controls = method.invert(clocked)
    seconds = time.perf_counter() - began - clocked.seconds
    _check(name, controls, true_rig, len(meshes))
    result = evaluate_controls(true_rig, meshes, controls)
    if effects is not None:
        result = result.with_accuracy(effects)
    values = {key.partition("/")[2]: value for key, value in result.metrics.items()}
    return Row(
        method=name,
        set=meshes.name,
        mean_vertex_error_mm=values["mean_vertex_error_mm"],
        max_vertex_error_mm=values["max_vertex_error_mm"],
        roughness=values.get("roughness"),
        nonzero_controls=nonzero_controls(controls, true_rig),
        ms_per_frame=1e3 * seconds / len(meshes),
        training_seconds=training_seconds,
        optimum_ratio=optimum.ratio(result) if optimum else None,
        optimum_mm=optimum.mean_mm if optimum else None,
        optimum_is_bound=float(optimum.is_bound) if optimum else None,
        **{key: values.get(key) for key in ACCURACY},
    )


def _check(name: str, controls: Tensor, rig: RigBackend, count: int) -> None:
    if controls.shape != (count, len(rig.controls)):
        raise InputError(
            f"method '{name}' gave controls of shape {tuple(controls.shape)}, expected {(count, len(rig.controls))}"
        )
    slack = 1e-5 * (rig.upper - rig.lower)
    if not bool(((controls >= rig.lower - slack) & (controls <= rig.upper + slack)).all()):
        raise InputError(f"method '{name}' gave controls that are NaN or outside the limits of rig '{rig.name}'")
