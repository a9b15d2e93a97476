"""python -m riginv.evaluate: evaluate a bundle on the true rig, or one rig against another."""

from riginv.launch.command import answer_help, command, run_directory

answer_help(__name__, "evaluate")  # before the imports that take seconds

from dataclasses import dataclass

from omegaconf import DictConfig

from riginv.clips.description_text import show_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.config.aliases import upgraded
from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.config.values import NonNegativeInt, PositiveInt
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_poses
from riginv.evaluation.models import evaluate_model, load_model, write_results
from riginv.evaluation.results import EvaluationResult, evaluate_rig, make_true_rig
from riginv.inference.inverse import Inverse
from riginv.rig.interface import RigBackend
from riginv.runs.console import show_lines
from riginv.runs.run_folder import METRICS, POSES, find_run_folder, plain_config
from riginv.runs.tables import print_results
from riginv.tracking.rigs import build_clip, build_true_rig


@dataclass(frozen=True)
class EvaluateConfig:
    """The config of `riginv.evaluate`; conf/evaluate.yaml explains each key."""

    rig: ClassSpec[RigBackend] | None
    true_rig: ClassSpec[RigBackend] | None
    reading: ReadingOptions
    frames: FrameOptions
    bundle: str | None
    capture: str | None
    refine: NonNegativeInt
    poses: PositiveInt
    fewer_controls: bool = False
    mean_steps: NonNegativeInt = 0
    resume: bool = False


def evaluate(config: DictConfig) -> None:
    """Evaluate a bundle on the true rig, or without a bundle one rig against another; write metrics and print a table."""
    settings = to_typed(config, EvaluateConfig)
    folder = find_run_folder(run_directory(), plain_config(config), settings.resume, upgrade=upgraded)
    title, true_rig, results = evaluate_bundle(settings, settings.bundle) if settings.bundle else compare_rigs(settings)
    folder.begin()
    metrics = write_results(folder.path, results, true_rig, {})
    notes = [f"The same figures:  {folder.path / METRICS}", f"The worst poses:   {folder.path / POSES}"]
    print_results(metrics, title, notes)


def evaluate_bundle(settings: EvaluateConfig, bundle: str) -> tuple[str, RigBackend, list[EvaluationResult]]:
    """Evaluate the model of a bundle: a title, the true rig and the results."""
    rig = settings.rig.build() if settings.rig else None
    model = load_model(bundle, rig, settings.refine, settings.fewer_controls, settings.mean_steps)
    trained_on = model.rig if isinstance(model, Inverse) else model
    true_rig, clip = build_true_rig(settings.true_rig, rig or trained_on), None
    if isinstance(model, Inverse):
        clip = build_clip(settings.capture, settings.reading, settings.frames, trained_on, true_rig, settings.poses)
    show_clip(clip)
    if settings.capture and not isinstance(model, Inverse):
        show_lines([], ["capture= was left out: a surrogate is evaluated on random poses, a clip evaluates an inverse"])
    title = bundle + (f" + {settings.refine} steps" if settings.refine else "")
    title += ", fewer controls" if settings.fewer_controls else ""
    title += f" + {settings.mean_steps} steps on the mean distance" if settings.mean_steps else ""
    return title, true_rig, evaluate_model(model, true_rig, settings.poses, clip)


def compare_rigs(settings: EvaluateConfig) -> tuple[str, RigBackend, list[EvaluationResult]]:
    """Evaluate the rig by the true rig on the same controls: a title, the true rig and the results.

    Raises:
        InputError: one of them is not named.
    """
    if settings.rig is None or settings.true_rig is None:
        raise InputError("nothing to evaluate: name a bundle with bundle=DIR, or two rigs with rig=NAME true_rig=NAME")
    rig = settings.rig.build()
    true_rig = make_true_rig(settings.true_rig, rig)
    poses = random_poses(true_rig, settings.poses).named("rig_agreement")
    return f"rig {rig.name} against {true_rig.name}", true_rig, [evaluate_rig(rig, poses)]


if __name__ == "__main__":
    command("evaluate")(evaluate)()
