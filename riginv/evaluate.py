"""python -m riginv.evaluate: judge a bundle by the true rig, or one rig by another."""

from omegaconf import DictConfig

from riginv.clips.description_text import show_clip
from riginv.config.building import build
from riginv.config.validation import validate
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_poses
from riginv.evaluation.models import evaluate_model, load_model, write_results
from riginv.evaluation.results import EvaluationResult, evaluate_rig, make_true_rig
from riginv.inference.inverse import Inverse
from riginv.launch.command import command, run_directory
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import PosedRig
from riginv.runs.console import show_lines
from riginv.runs.run_folder import METRICS, POSES, find_run_folder, plain_config
from riginv.runs.tables import print_results
from riginv.training.assembly import Config, build_clip, build_true_rig


def evaluate(config: DictConfig) -> None:
    """Judge a bundle by the true rig, or, where none is named, one rig by another; leave metrics and a table behind."""
    plain = plain_config(config)
    validate(plain)
    folder = find_run_folder(run_directory(), plain, config.resume)
    title, true_rig, results = evaluate_bundle(plain) if plain["bundle"] else compare_rigs(plain)
    folder.begin()
    metrics = write_results(folder.path, results, true_rig, {})
    notes = [f"The same figures:  {folder.path / METRICS}", f"The worst poses:   {folder.path / POSES}"]
    print_results(metrics, title, notes)


def evaluate_bundle(config: Config) -> tuple[str, RigBackend, list[EvaluationResult]]:
    """Judge the model of `config["bundle"]`: a title, the judge and what came of it."""
    rig = build(config["rig"], kind=RigBackend) if config["rig"]["_target_"] else None
    model = load_model(config["bundle"], rig, config["refine"])
    is_inverse = isinstance(model, Inverse)
    true_rig = build_true_rig(config, rig or (model.rig if is_inverse else model))
    clip = build_clip(config, model.rig, true_rig) if is_inverse else None
    show_clip(clip)
    if config["capture"] and not is_inverse:
        show_lines([], ["capture= was left out: a surrogate is judged on random poses, a clip judges an inverse"])
    title = f"{config['bundle']}" + (f" + {config['refine']} steps" if config["refine"] else "")
    return title, true_rig, evaluate_model(model, true_rig, config["poses"], clip)


def compare_rigs(config: Config) -> tuple[str, RigBackend, list[EvaluationResult]]:
    """Judge `config["rig"]` by `config["true_rig"]` on the same controls: a title, the judge and what came of it.

    Raises:
        InputError: one of them is not named.
    """
    if not (config["rig"]["_target_"] and config["true_rig"]["_target_"]):
        raise InputError("nothing to judge: name a bundle with bundle=DIR, or two rigs with rig=NAME true_rig=NAME")
    rig = build(config["rig"], kind=RigBackend)
    true_rig = make_true_rig(config["true_rig"], rig)
    controls = random_poses(true_rig, config["poses"]).controls
    return (
        f"rig {rig.name} against {true_rig.name}",
        true_rig,
        [evaluate_rig(rig, PosedRig("rig_agreement", true_rig, controls))],
    )


if __name__ == "__main__":
    command("evaluate")(evaluate)()
