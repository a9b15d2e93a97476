"""From a config to the parts of a training run: each is built once and handed on."""

from typing import Any

import lightning as L
import torch
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import LearningRateMonitor
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.strategies import DDPStrategy
from omegaconf import DictConfig, open_dict
from torch import nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from riginv.clips.options import clip_options
from riginv.clips.performance import simulated_performance
from riginv.config.building import OURS, build, class_of, factory
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_poses, random_sets, watched
from riginv.evaluation.results import check_same_controls, make_true_rig
from riginv.networks.base import RigNetwork, compile_parts, use_bfloat16
from riginv.rig.batches import generator_at
from riginv.rig.black_box import BlackBoxRig
from riginv.rig.interface import LinearRig, RigBackend
from riginv.rig.mesh_sets import MeshSet, StoredMeshes
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.recorded import RecordedRig
from riginv.runs.run_folder import RunFolder
from riginv.runs.threads import Workers
from riginv.sampling.meshes import MeshSampler, StoredPoses, WithNoise, select_for_rig
from riginv.sampling.noise import CaptureNoise
from riginv.store.training import reading_store, rig_of_store
from riginv.tracking.capture import open_capture
from riginv.training.checkpoints import AtomicCheckpoints, SaveLast, TrainingClock
from riginv.training.data import PoseDataModule
from riginv.training.devices import this_process
from riginv.training.halves import HALVES
from riginv.training.holden import HoldenModule
from riginv.training.inverse import InverseModule
from riginv.training.module import RigModule
from riginv.training.pictures import PosePictures
from riginv.training.progress import TrainingProgress

Config = dict[str, Any]
CALIBRATION_MESHES = 1024
NOT_LIGHTNINGS = ("precision", "compile", "starts_processes", "threads")  # keys of a trainer
BFLOAT16 = "bf16-mixed"
NOT_OPTIONS = ("network", "loss", "optimizer", "schedule", "cpu_steps")  # of a model; the rest are numbers of its module


def build_rig(config: Config) -> LinearRig:
    """The rig to train on; one that does not end in a linear map is posed at random, to find one that it nearly ends in.

    Raises:
        InputError: it cannot be built or posed.
    """
    rig = build(config["rig"], kind=RigBackend)
    if isinstance(rig, LinearRig):
        return rig
    stored = config.get("data", {}).get("store")
    return rig_of_store(stored, rig) if stored else BlackBoxRig.sampled(rig, **config["mesh_space"])


def needs_surrogate(config: Config, rig: LinearRig) -> bool:
    """Whether the model can only be trained through a surrogate: no gradient passes through the rig, or it cannot be posed."""
    kind = class_of(config["model"]["_target_"], kind=RigModule)
    return (issubclass(kind, InverseModule) and not rig.differentiable) or (
        issubclass(kind, HoldenModule) and isinstance(rig, RecordedRig)
    )


def as_surrogate(config: DictConfig) -> DictConfig:
    """The config of the surrogate that a run trains first."""
    first = config.copy()
    with open_dict(first):
        first.model = first.surrogate
    return first


def build_true_rig(config: Config, rig: RigBackend) -> RigBackend:
    """The rig that judges: the one that the config names, or what a surrogate was trained on, or the rig itself.

    Raises:
        InputError: it cannot be built, or has other controls or vertices than the rig.
    """
    rig = rig.posed if isinstance(rig, BlackBoxRig) else rig
    if config["true_rig"].get("_target_"):
        return make_true_rig(config["true_rig"], rig)
    if hasattr(rig, "true_rig_config"):
        true_rig = build(rig.true_rig_config, kind=RigBackend, only=OURS)
    else:
        true_rig = rig
    check_same_controls(rig, true_rig)
    return true_rig


def build_clip(config: Config, rig: LinearRig, true_rig: RigBackend) -> MeshSet | None:
    """The clip to judge on: the one given, or else the rig's own motion, or a simulated performance; None where it has none.

    Raises:
        InputError: the clip cannot be read or is none of the rig, or the rig's motion holds what is no number.
    """
    options = clip_options(config)
    if config["capture"]:
        posed = rig if isinstance(true_rig, RecordedRig) else true_rig
        return open_capture(config["capture"], posed, rig, *options)
    motion = true_rig.motion()
    if motion is None:
        return simulated_performance(true_rig)
    broken = (~motion.vertices.isfinite().all(dim=2).all(dim=1)).nonzero()[:, 0]
    if len(broken):
        raise InputError(
            f"rig '{true_rig.name}': frame {int(broken[0])} of its motion '{motion.name}' holds NaN or infinite values"
        )
    return StoredMeshes(motion.name, motion.vertices, motion.fps)


def build_module(config: Config, rig: RigInMeshSpace, true_rig: RigBackend) -> RigModule:
    """The Lightning module with its network, loss, optimiser and schedule, and the rig that judges."""
    model = dict(config["model"])
    module_class = class_of(model.pop("_target_"), kind=RigModule)
    network = build(model["network"], rig if module_class.kind == "inverse" else rig.rig, kind=RigNetwork)
    losses = [build(model["loss"], rig.space.vertex_count, kind=nn.Module)] if "loss" in model else []
    learning = factory(model["optimizer"], Optimizer), factory(model["schedule"], LRScheduler)
    options = {key: value for key, value in model.items() if key not in NOT_OPTIONS}
    module = module_class(rig, network, *losses, *learning, **options)
    module.true_rig = rig.rig if isinstance(true_rig, RecordedRig) else true_rig
    module.stop_below_lr = config["stop_below_lr"]
    module.workers = build_workers(config["trainer"])
    return module


def build_workers(trainer: Config) -> Workers | None:
    """The threads that compute a training step; None where there are several processes, one for each core."""
    if trainer.get("devices", 1) != 1 or trainer.get("num_nodes", 1) != 1:
        return None
    chosen = trainer.get("threads", "auto")
    return Workers(None if chosen == "auto" else chosen, most=HALVES)


def build_sampler(config: Config, rig: RigInMeshSpace) -> MeshSampler:
    """What training sees, with capture noise and storage where the config asks for them."""
    noise, stored = config["noise"], config["data"]["stored_poses"]
    if isinstance(rig.rig, RecordedRig):
        sampler = StoredPoses(rig.rig.poses_to_train_on(rig.space))
    else:
        sampler = build(select_for_rig(config["sampler"], rig.rig), rig, kind=MeshSampler)
        if config["data"]["store"]:
            sampler = reading_store(sampler, rig, config)
        elif not rig.rig.differentiable:
            stored = stored or config["data"]["black_box_poses"]
    if stored:
        sampler = StoredPoses.drawn(sampler, stored, generator_at(config["seed"], "stored poses"))
    if noise["vertex_mm"] or noise["smooth_mm"]:
        sampler = WithNoise(sampler, CaptureNoise(rig.space, **noise))
    return sampler


def build_data(config: Config, module: RigModule, true_rig: RigBackend, clip: MeshSet | None) -> PoseDataModule:
    """The stream of training batches, and the sets that are watched meanwhile."""
    sampler, count = build_sampler(config, module.rig), config["judging"]["validation_poses"]
    if isinstance(true_rig, RecordedRig):
        sets = [true_rig.held_out]
    elif module.kind == "forward":
        sets = [random_poses(true_rig, count, "validation")]
    else:
        sets = [*random_sets(true_rig, count, "validation"), *([clip] if clip else [])]
    data, space = config["data"], module.rig.space
    return PoseDataModule(sampler, watched(sets, space, count), data["batch_size"], data["steps_per_epoch"], config["seed"])


def calibrate(config: Config, module: RigModule, sampler: MeshSampler) -> None:
    """Let the network set its fixed scales by a sample of what it will see."""
    sample = sampler.sample(CALIBRATION_MESHES, generator_at(config["seed"], "calibration"))
    if module.kind == "inverse":
        module.network.calibrate(sample["coordinates"])
    elif not isinstance(module.rig.rig, BlackBoxRig | RecordedRig):  # the coefficients of these are scaled already
        module.network.set_scales(module.rig.rig, sample["controls"])


def trainer_arguments(config: Config) -> dict[str, Any]:
    """What of a config's trainer is Lightning's."""
    arguments = {key: value for key, value in config["trainer"].items() if key not in NOT_LIGHTNINGS}
    return {**arguments, "max_steps": -1 if arguments["max_steps"] is None else arguments["max_steps"]}


def speed_up(config: Config, module: RigModule, device: torch.device) -> None:
    """Train in bfloat16, or in compiled code, where the config says so: what learns, and neither the rig nor the losses.

    Raises:
        InputError: nothing can be compiled here.
    """
    if config["trainer"]["precision"] == BFLOAT16:
        use_bfloat16(module.network)
    if config["trainer"]["compile"]:
        compile_parts(module.network, device)


def build_trainer(config: Config, folder: RunFolder) -> tuple[L.Trainer, TrainingClock]:
    """Lightning's trainer with everything that happens around training.

    Raises:
        InputError: the device is not there.
    """
    clock = TrainingClock()
    callbacks = [
        clock,
        TrainingProgress(),
        LearningRateMonitor(),
        SaveLast(folder.path, config["checkpoint"]["every_n_steps"]),
    ]
    if config["pictures"]["every_n_validations"]:
        callbacks.append(PosePictures(config["pictures"]["every_n_validations"]))
    process = this_process(config)
    plugins = [AtomicCheckpoints()]
    arguments = trainer_arguments(config)
    if process.environment is not None:
        plugins.append(process.environment)
        # A rig's buffers are large and never change: they are not sent anew at every step.
        arguments |= {"strategy": DDPStrategy(broadcast_buffers=False), "sync_batchnorm": True}
    elif process.must_start_others:
        raise InputError(f"trainer.devices is {arguments['devices']}: only python -m riginv.train trains on several devices")
    try:
        trainer = L.Trainer(
            **arguments,
            max_epochs=-1,
            default_root_dir=folder.path,
            logger=TensorBoardLogger(folder.path, name="", version="", default_hp_metric=False),
            callbacks=callbacks,
            plugins=plugins,
            use_distributed_sampler=False,  # PoseDataModule shares out; Lightning would repeat meshes to even the shares
            enable_checkpointing=False,  # SaveLast does it
            enable_model_summary=False,
            enable_progress_bar=False,  # TrainingProgress is it
            num_sanity_val_steps=0,
            inference_mode=False,  # a staged network asks the rig for gradients when it is used, too
        )
    except (MisconfigurationException, ImportError, RuntimeError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"trainer.accelerator={arguments['accelerator']} cannot be used here: {reason}") from None
    return trainer, clock
