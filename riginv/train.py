"""python -m riginv.train: from a config to an evaluated, bundled model."""

from riginv.launch.command import answer_help, command, run_directory

answer_help(__name__, "train")  # before the imports that take seconds

from dataclasses import replace
from typing import Any

import lightning as L
from omegaconf import DictConfig

from riginv.clips.description_text import show_clip
from riginv.config.aliases import upgraded
from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.evaluation.models import evaluate_model, load_model, surrogate_config, write_results
from riginv.inference.bundle import is_damaged, write_bundle
from riginv.launch.device_launcher import run_in_processes
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.rig.size import show_rig
from riginv.runs.run_folder import BUNDLE, SURROGATE, RunFolder, find_run_folder, plain_config
from riginv.tracking.rigs import build_clip, build_rig, build_true_rig
from riginv.training.assembly import as_surrogate, build_data, build_module, build_trainer, calibrate, needs_surrogate, speed_up
from riginv.training.config import TrainConfig
from riginv.training.dashboard import log_choices, log_results
from riginv.training.devices import leave_process_group, this_process
from riginv.training.summary import show


def train(config: DictConfig) -> None:
    """Train a network on a rig, evaluate it on the true rig, write bundle and metrics, and print a table."""
    settings = to_typed(config, TrainConfig)
    process = this_process(settings.trainer, settings.data.batch_size)
    folder = find_run_folder(run_directory(), plain_config(config), settings.resume, process.rank == 0, upgraded)
    done = folder.finished and not is_damaged(folder.path / BUNDLE)
    if process.must_start_others and not done:
        run_in_processes(process.count, folder.path)
    elif not done:
        rig = build_rig(settings.rig, settings.mesh_space, settings.data.store)
        true_rig = build_true_rig(settings.true_rig, rig)
        if needs_surrogate(settings.model, rig):
            surrogate = train_surrogate_first(config, folder, rig, true_rig)
            rig = build_rig(surrogate, settings.mesh_space)
            fit(replace(settings, rig=surrogate), folder, rig, true_rig)
        else:
            fit(settings, folder, rig, true_rig)
    if process.shows:
        show(folder, settings.rig.target)


def fit(settings: TrainConfig, folder: RunFolder, rig: LinearRig, true_rig: RigBackend, last: bool = True) -> None:
    """Train one model in a run's folder, write its bundle, and evaluate it.

    Args:
        last: whether no further model is trained by these processes; then their process group is destroyed.
    """
    is_inverse = settings.model.module.target_class.kind == "inverse"
    poses, clip = settings.evaluation.test_poses, None
    if is_inverse:
        clip = build_clip(settings.capture, settings.reading, settings.frames, rig, true_rig, poses)
    if folder.is_writer:
        show_clip(clip)
        show_rig(rig, settings.rig.config)
    trainer, training = fit_network(settings, folder, RigInMeshSpace(rig, MeshSpace.from_rig(rig)), true_rig, clip)
    if last:
        leave_process_group()
    if not folder.is_writer:
        return
    model = load_model(folder.path / BUNDLE, rig)
    results = evaluate_model(model, true_rig, poses, clip)
    facts = {"train/steps": training["steps"], "train/seconds": training["seconds"], "seed": settings.seed}
    log_results(trainer, write_results(folder.path, results, true_rig, facts, settings.pictures.final))


def fit_network(
    settings: TrainConfig, folder: RunFolder, rig: RigInMeshSpace, true_rig: RigBackend, clip: MeshSet | None
) -> tuple[L.Trainer, dict[str, Any]]:
    """Train a network and write its bundle into a run's folder; the trainer, and the facts of training in the bundle."""
    L.seed_everything(settings.seed, verbose=False)
    module = build_module(settings, rig, true_rig)
    data = build_data(settings, module, true_rig, clip)
    calibrate(settings.seed, module, data.sampler)
    trainer, clock = build_trainer(settings, folder)

    folder.begin()
    log_choices(trainer, folder.config)
    speed_up(settings.trainer, module, trainer.strategy.root_device)
    trainer.fit(module, data, ckpt_path=folder.checkpoint, weights_only=True)

    training = {"steps": trainer.global_step, "seconds": round(clock.seconds, 1), "seed": settings.seed}
    if folder.is_writer:
        configs = settings.model.network.config, settings.rig.config
        write_bundle(folder.path / BUNDLE, module.kind, module.network, module.rig, *configs, training)
    return trainer, training


def train_surrogate_first(config: DictConfig, folder: RunFolder, rig: LinearRig, true_rig: RigBackend) -> ClassSpec[RigBackend]:
    """Train a surrogate of a rig that gives no gradients, in the run's own folder; the class of that surrogate as a rig."""
    first = as_surrogate(config)
    settings = to_typed(first, TrainConfig)
    inner = find_run_folder(folder.path / SURROGATE, plain_config(first), True, folder.is_writer, upgraded)
    folder.begin()
    if not inner.finished:
        if folder.is_writer:
            print(f"No gradient passes through rig {rig.name}: first a surrogate of it, then the inverse through that.")
        fit(settings, inner, rig, true_rig, last=False)
        inner.wait_until_finished()
        if folder.is_writer:
            show(inner, settings.rig.target)
    return ClassSpec.read(surrogate_config(inner.path), RigBackend)


if __name__ == "__main__":
    command("train")(train)()
