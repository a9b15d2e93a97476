"""Judging what a bundle holds: the same for a model just trained and for one trained long ago."""

from pathlib import Path

from riginv.build import OURS, build
from riginv.bundle import read_bundle
from riginv.data.mesh_sets import MeshSet
from riginv.data.test_sets import random_poses, random_sets
from riginv.inverse import Inverse, load_inverse
from riginv.judge import check_same_controls, judge_inverse, judge_rig
from riginv.rig import LinearRig, RigBackend

SURROGATE = "rigs.surrogate.SurrogateRig"


def load_model(folder: str | Path, rig: LinearRig | None = None) -> Inverse | LinearRig:
    """Load what a bundle holds: an inverse, or a surrogate as a rig.

    Args:
        rig: the rig that an inverse was trained on, for one that is not part of riginv.

    Raises:
        InputError: the bundle is missing or damaged, or does not fit the rig.
    """
    if read_bundle(folder).description["kind"] == "forward":
        return build({"_target_": SURROGATE, "bundle": str(folder)}, only=OURS)
    return load_inverse(folder, rig)


def judge_model(model: Inverse | LinearRig, true_rig: RigBackend, poses: int, clip: MeshSet | None) -> dict[str, float]:
    """Judge an inverse on the random test sets and a clip, or a surrogate on random poses, by the true rig.

    Args:
        poses: meshes in each random test set.
        clip: only for an inverse.

    Returns:
        Metrics by `SET/key`.

    Raises:
        InputError: the true rig has other controls or vertices.
    """
    if not isinstance(model, Inverse):
        check_same_controls(model, true_rig)
        return judge_rig(model, true_rig, random_poses(true_rig, poses).controls, "rig_poses")
    check_same_controls(model.rig, true_rig)
    metrics: dict[str, float] = {}
    for mesh_set in [*random_sets(true_rig, poses), *([clip] if clip else [])]:
        metrics.update(judge_inverse(model, true_rig, mesh_set))
    return metrics
