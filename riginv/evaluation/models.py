"""Evaluation of a bundle's model; the same code for a model just trained and for a loaded one."""

from pathlib import Path
from typing import Any

from riginv.config.building import OURS, build
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_poses, random_sets
from riginv.evaluation.optimum import find_optima
from riginv.evaluation.results import EvaluationResult, check_same_controls, evaluate_inverse, evaluate_rig
from riginv.inference.bundle import read_bundle
from riginv.inference.inverse import Inverse, load_inverse
from riginv.meshes.rendering import comparison
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.runs.files import atomic_write, write_json
from riginv.runs.run_folder import METRICS, POSES
from riginv.runs.tables import NO_RIG


def surrogate_config(folder: str | Path) -> dict[str, str]:
    """The config of the surrogate rig in a bundle, or in the run that holds it."""
    return {"_target_": "rigs.surrogate.SurrogateRig", "bundle": str(folder)}


def load_model(
    folder: str | Path,
    rig: RigBackend | None = None,
    refine: int = 0,
    fewer_controls: bool = False,
    mean_steps: int = 0,
) -> Inverse | LinearRig:
    """Load what a bundle holds: an inverse, or a surrogate as a rig.

    Args:
        rig: the rig that an inverse was trained on, for one that is not part of riginv.
        refine, fewer_controls, mean_steps: as in `load_inverse`.

    Raises:
        InputError: the bundle is missing or damaged, does not fit the rig, or is no inverse that could be refined.
    """
    if read_bundle(folder).description["kind"] == "forward":
        for key, given in (("refine", refine), ("mean_steps", mean_steps), ("fewer_controls", fewer_controls)):
            if given:
                raise InputError(f"{key}={str(given).lower()} is for an inverse; {folder} holds a surrogate: leave it out")
        return build(surrogate_config(folder), kind=LinearRig, only=OURS)
    return load_inverse(folder, rig, refine, fewer_controls, mean_steps)


def evaluate_model(
    model: Inverse | LinearRig, true_rig: RigBackend, poses: int, clip: MeshSet | None
) -> list[EvaluationResult]:
    """Evaluate an inverse on the random test sets and a clip, or a surrogate on random poses, on the true rig.

    For a recorded rig the held-out poses are the test set; the surrogate poses the predicted controls, and is itself
    evaluated too. For a differentiable true rig the optimum is computed on a few meshes of each set; an upper bound of it where
    the basis is fitted.

    Args:
        poses: meshes in each random test set.
        clip: only for an inverse.

    Raises:
        InputError: the true rig has other controls or vertices.
    """
    rig = model.rig if isinstance(model, Inverse) else model
    check_same_controls(rig, true_rig)
    if (held_out := true_rig.held_out) is not None:
        if not isinstance(model, Inverse):
            return [evaluate_rig(rig, held_out)]
        sets = [held_out, *([clip] if clip else [])]
        inverted = [evaluate_inverse(model, rig, meshes).with_accuracy(ControlEffects.of_rig(rig)) for meshes in sets]
        return [*inverted, evaluate_rig(rig, held_out.named("surrogate"))]
    if not isinstance(model, Inverse):
        return [evaluate_rig(model, random_poses(true_rig, poses))]
    sets = [*random_sets(true_rig, poses), *([clip] if clip else [])]
    optima = find_optima(true_rig, sets, model.rig)
    effects = ControlEffects.of_rig(true_rig)
    results = [evaluate_inverse(model, true_rig, meshes).with_accuracy(effects) for meshes in sets]
    for result in results:
        if optimum := optima.get(result.meshes.name):
            result.metrics.update(optimum.metrics(result))
    return results


def write_results(
    folder: Path, results: list[EvaluationResult], true_rig: RigBackend, more: dict[str, float], picture: bool = True
) -> dict[str, Any]:
    """Write `poses.png`, the worst and the median mesh of each set, and `metrics.json`, and return the metrics.

    Args:
        more: further metrics, by key.
        picture: whether `poses.png` is drawn.
    """
    if picture:
        pairs = [pair for result in results for pair in result.worst_and_median()]
        with atomic_write(folder / POSES) as beside:
            comparison(true_rig, pairs).save(beside, format="PNG")
    metrics: dict[str, Any] = {key: value for result in results for key, value in result.metrics.items()}
    metrics |= {**more, "true_rig": true_rig.name if true_rig.held_out is None else NO_RIG}
    write_json(folder / METRICS, metrics)
    return metrics
