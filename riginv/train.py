"""python -m riginv.train: from a config to a judged, bundled model."""

from typing import Any

import lightning as L
from omegaconf import DictConfig

from riginv.clips.description_text import show_clip
from riginv.config.building import class_of
from riginv.config.validation import validate
from riginv.evaluation.models import evaluate_model, load_model, surrogate_config, write_results
from riginv.inference.bundle import is_damaged, write_bundle
from riginv.launch.command import command, run_directory
from riginv.launch.starter import run_in_processes
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.size import show_rig
from riginv.runs.run_folder import BUNDLE, SURROGATE, RunFolder, find_run_folder, plain_config
from riginv.training.assembly import (
    Config,
    as_surrogate,
    build_clip,
    build_data,
    build_module,
    build_rig,
    build_trainer,
    build_true_rig,
    calibrate,
    needs_surrogate,
    speed_up,
)
from riginv.training.devices import part, this_process
from riginv.training.module import RigModule
from riginv.training.pictures import log_choices, log_results
from riginv.training.summary import show


def train(config: DictConfig) -> None:
    """Train a network on a rig, judge it by the true rig, and leave a bundle, metrics and a table behind."""
    plain = plain_config(config)
    validate(plain)
    process = this_process(plain)
    folder = find_run_folder(run_directory(), plain, config.resume, process.rank == 0)
    done = folder.finished and not is_damaged(folder.path / BUNDLE)
    if process.must_start_others and not done:
        run_in_processes(process.count, folder.path)
    elif not done:
        rig = build_rig(plain)
        true_rig = build_true_rig(plain, rig)
        if needs_surrogate(plain, rig):
            plain, rig = train_surrogate_first(config, folder, rig, true_rig)
        fit(plain, folder, rig, true_rig)
    if process.shows:
        show(folder)


def fit(plain: Config, folder: RunFolder, rig: LinearRig, true_rig: RigBackend, last: bool = True) -> None:
    """From a rig to a judged, bundled model in a run's folder; `last`: nothing is trained after it, by several processes."""
    is_inverse = class_of(plain["model"]["_target_"], kind=RigModule).kind == "inverse"
    clip = build_clip(plain, rig, true_rig) if is_inverse else None
    if folder.written_here:
        show_clip(clip)
        show_rig(rig, plain["rig"])
    trainer, training = fit_network(plain, folder, RigInMeshSpace(rig, MeshSpace.from_rig(rig)), true_rig, clip)
    if last:
        part()
    if not folder.written_here:
        return
    model = load_model(folder.path / BUNDLE, rig)
    results = evaluate_model(model, true_rig, plain["judging"]["test_poses"], clip)
    facts = {"train/steps": training["steps"], "train/seconds": training["seconds"], "seed": plain["seed"]}
    log_results(trainer.logger, write_results(folder.path, results, true_rig, facts), trainer.global_step)


def fit_network(
    plain: Config, folder: RunFolder, rig: RigInMeshSpace, true_rig: RigBackend, clip: MeshSet | None
) -> tuple[L.Trainer, dict[str, Any]]:
    """Train a network and write its bundle into a run's folder; the trainer, and the facts of training in the bundle."""
    L.seed_everything(plain["seed"], verbose=False)
    module = build_module(plain, rig, true_rig)
    data = build_data(plain, module, true_rig, clip)
    calibrate(plain, module, data.sampler)
    trainer, clock = build_trainer(plain, folder)

    folder.begin()
    log_choices(trainer.logger, plain)
    speed_up(plain, module, trainer.strategy.root_device)
    trainer.fit(module, data, ckpt_path=folder.checkpoint, weights_only=True)

    training = {"steps": trainer.global_step, "seconds": round(clock.seconds, 1), "seed": plain["seed"]}
    if folder.written_here:
        write_bundle(folder.path / BUNDLE, module.kind, module.network, module.rig, plain, training)
    return trainer, training


def train_surrogate_first(
    config: DictConfig, folder: RunFolder, rig: LinearRig, true_rig: RigBackend
) -> tuple[Config, LinearRig]:
    """Train a surrogate of a rig that gives no gradients, in the run's own folder; the config and the rig to go on with."""
    first = plain_config(as_surrogate(config))
    inner = find_run_folder(folder.path / SURROGATE, first, True, folder.written_here)
    folder.begin()
    if not inner.finished:
        if folder.written_here:
            print(f"No gradient passes through rig {rig.name}: first a surrogate of it, then the inverse through that.")
        fit(first, inner, rig, true_rig, last=False)
        inner.wait_until_finished()
        if folder.written_here:
            show(inner)
    through = {**folder.config, "rig": surrogate_config(inner.path)}
    return through, build_rig(through)


if __name__ == "__main__":
    command("train")(train)()
