"""Builds the objects of a training run from its config."""

from typing import Any, cast

import lightning as L
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import LearningRateMonitor
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.strategies import DDPStrategy
from omegaconf import DictConfig, open_dict

from riginv.config.building import build
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_poses, random_sets, watched
from riginv.networks.base import compile_parts, use_bfloat16
from riginv.networks.inverse import InverseNetwork
from riginv.networks.surrogate import SurrogateNetwork
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.runs.run_folder import RunFolder
from riginv.runs.threads import Workers
from riginv.sampling.meshes import MeshSampler, StoredPoses, WithNoise, select_for_rig
from riginv.sampling.noise import CaptureNoise
from riginv.training.checkpoints import AtomicCheckpoints, SaveLast, TrainingClock
from riginv.training.config import ModelConfig, TrainConfig, TrainerConfig
from riginv.training.dashboard import Dashboard, PosePictures
from riginv.training.data import PoseDataModule
from riginv.training.devices import this_process
from riginv.training.module import RigModule
from riginv.training.parallel import HALVES
from riginv.training.summary import TrainingProgress

CALIBRATION_MESHES = 1024
BFLOAT16 = "bf16-mixed"


def needs_surrogate(model: ModelConfig, rig: LinearRig) -> bool:
    """Whether the model can only be trained through a surrogate: no gradient passes through the rig, or it cannot be posed."""
    return not model.module.target_class.can_train_on(rig)


def as_surrogate(config: DictConfig) -> DictConfig:
    """The config of the surrogate that a run trains first."""
    first = config.copy()
    with open_dict(first):
        first.model = first.surrogate
    return first


def build_module(settings: TrainConfig, rig: RigInMeshSpace, true_rig: RigBackend) -> RigModule:
    """The Lightning module with its network, loss, optimiser and schedule, and the rig that evaluates."""
    model = settings.model
    network = model.network.build(rig if model.module.target_class.kind == "inverse" else rig.source)
    losses = [model.loss.build(rig.space.vertex_count)] if model.loss else []
    module = model.module.build(rig, network, *losses, model.optimizer.factory(), model.schedule.factory())
    module.true_rig = true_rig if true_rig.held_out is None else rig.source
    module.stop_below_lr = settings.stop_below_lr
    module.workers = build_workers(settings.trainer)
    module.uses_graphs = settings.trainer.cuda_graphs
    return module


def build_workers(trainer: TrainerConfig) -> Workers | None:
    """The threads that compute a training step; None where there are several processes, one for each core."""
    if trainer.processes != 1:
        return None
    return Workers(None if trainer.threads == "auto" else trainer.threads, most=HALVES)


def build_sampler(settings: TrainConfig, rig: RigInMeshSpace) -> MeshSampler:
    """The sampler of training meshes, with stored poses and capture noise as configured."""
    data, noise, stored = settings.data, settings.noise, settings.data.stored_poses
    recorded = rig.source.poses_to_train_on(rig.space)
    if recorded is not None:
        sampler: MeshSampler = StoredPoses(recorded)
    else:
        sampler = build(select_for_rig(dict(settings.sampler.config), rig.source), rig, kind=MeshSampler)
        if data.store:
            from riginv.sampling.store.training import reading_store  # zarr takes a quarter of a second

            sampler = reading_store(sampler, rig, data.store, settings.seed)
        elif not rig.source.differentiable:
            stored = stored or data.black_box_poses
    if stored:
        sampler = StoredPoses.drawn(sampler, stored, generator_at(settings.seed, "stored poses"))
    if noise:
        sampler = WithNoise(sampler, CaptureNoise(rig.space, noise.vertex_mm, noise.smooth_mm, noise.radius_mm))
    return sampler


def build_data(settings: TrainConfig, module: RigModule, true_rig: RigBackend, clip: MeshSet | None) -> PoseDataModule:
    """The training batches and the validation sets."""
    sampler, count = build_sampler(settings, module.rig), settings.evaluation.validation_poses
    if true_rig.held_out is not None:
        sets = [true_rig.held_out]
    elif module.kind == "forward":
        sets = [random_poses(true_rig, count, "validation")]
    else:
        sets = [*random_sets(true_rig, count, "validation"), *([clip] if clip else [])]
    data, validation = settings.data, watched(sets, module.rig.space, count)
    sizes = data.batch_size, data.steps_per_epoch
    return PoseDataModule(sampler, validation, *sizes, settings.seed, settings.trainer.cuda_graphs)


def calibrate(seed: int, module: RigModule, sampler: MeshSampler) -> None:
    """Set the network's fixed scales from sampled training meshes."""
    sample = sampler.sample(CALIBRATION_MESHES, generator_at(seed, "calibration"))
    if module.kind == "inverse":
        cast(InverseNetwork, module.network).calibrate(sample["coordinates"])
    elif not module.rig.source.is_fitted:  # the coefficients of these are scaled already
        cast(SurrogateNetwork, module.network).set_scales(module.rig.source, sample["controls"])


def speed_up(trainer: TrainerConfig, module: RigModule, device: torch.device) -> None:
    """Train in bfloat16, or in compiled code, as configured; this affects the network, not the rig and the losses.

    Raises:
        InputError: nothing can be compiled here.
    """
    if trainer.precision == BFLOAT16:
        use_bfloat16(module.network)
    if trainer.compile:
        compile_parts(module.network, device)


def lightning_arguments(trainer: TrainerConfig) -> dict[str, Any]:
    """The arguments of Lightning's trainer that a config decides."""
    return {
        "accelerator": trainer.accelerator,
        "devices": trainer.devices,
        "num_nodes": trainer.num_nodes,
        "max_steps": -1 if trainer.max_steps is None else trainer.max_steps,
        "deterministic": trainer.deterministic,
        "log_every_n_steps": trainer.log_every_n_steps,
    }


def build_trainer(settings: TrainConfig, folder: RunFolder) -> tuple[L.Trainer, TrainingClock]:
    """Lightning's trainer with its callbacks, logger and plugins, and the clock of training time.

    Raises:
        InputError: the device is not there.
    """
    clock = TrainingClock()
    callbacks = [
        clock,
        TrainingProgress(),
        LearningRateMonitor(),
        Dashboard(),
        SaveLast(folder.path, settings.checkpoint.every_n_steps),
    ]
    if settings.pictures.every_n_validations:
        callbacks.append(PosePictures(settings.pictures.every_n_validations))
    process = this_process(settings.trainer, settings.data.batch_size)
    plugins: list[Any] = [AtomicCheckpoints()]
    arguments = lightning_arguments(settings.trainer)
    if process.environment is not None:
        plugins.append(process.environment)
        # A rig's buffers are large and never change: they are not sent at every step.
        arguments |= {"strategy": DDPStrategy(broadcast_buffers=False), "sync_batchnorm": True}
    elif process.must_start_others:
        raise InputError(
            f"trainer.devices is {settings.trainer.devices}: only python -m riginv.train trains on several devices"
        )
    try:
        trainer = L.Trainer(
            **arguments,
            max_epochs=-1,
            default_root_dir=folder.path,
            logger=TensorBoardLogger(folder.path, name="", version="", default_hp_metric=False),
            callbacks=callbacks,
            plugins=plugins,
            use_distributed_sampler=False,  # PoseDataModule splits batches; Lightning's sampler would repeat meshes
            enable_checkpointing=False,  # SaveLast does it
            enable_model_summary=False,
            enable_progress_bar=False,  # TrainingProgress is it
            num_sanity_val_steps=0,
            inference_mode=False,  # a staged network needs gradients of the rig in inference, too
        )
    except (MisconfigurationException, ImportError, RuntimeError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0]
        if settings.trainer.accelerator in ("gpu", "cuda") and not torch.cuda.is_available():
            reason = "PyTorch finds no GPU: train with trainer=cpu, or install a PyTorch for your GPU and its driver"
        raise InputError(f"trainer.accelerator={settings.trainer.accelerator} cannot be used here: {reason}") from None
    return trainer, clock
