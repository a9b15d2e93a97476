"""The config of `riginv.train` (conf/train.yaml) as dataclasses."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from torch import nn
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.config.building import ClassSpec
from riginv.config.typed import REST, MeshSpaceConfig
from riginv.config.values import NonEmpty, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from riginv.networks.base import RigNetwork
from riginv.rig.interface import RigBackend
from riginv.sampling.meshes import MeshSampler
from riginv.training.devices import TrainerConfig
from riginv.training.module import RigModule


@dataclass(frozen=True)
class ModelConfig:
    """The module, network, loss, optimiser and schedule.

    Attributes:
        module: the Lightning module, with the options that are its own.
        cpu_steps: training steps on CPUs, unless `trainer.max_steps` says otherwise.
        loss: None: the module brings its own.
    """

    module: ClassSpec[RigModule] = field(metadata=REST)
    network: ClassSpec[RigNetwork]
    optimizer: ClassSpec[Optimizer]
    schedule: ClassSpec[LRScheduler]
    cpu_steps: PositiveInt
    loss: ClassSpec[nn.Module] | None = None

    def __post_init__(self) -> None:
        self.optimizer.check(lr=PositiveFloat, weight_decay=NonNegativeFloat)


@dataclass(frozen=True)
class DataConfig:
    """Training batches.

    Attributes:
        batch_size: meshes in a batch, those of all devices together.
        steps_per_epoch: training steps between two validations.
        stored_poses: fixed samples to train on; None: new ones every step.
        store: a finished store of poses (riginv.sample) to train on.
        black_box_poses: as `stored_poses`, for rigs that no gradient passes through.
    """

    batch_size: PositiveInt
    steps_per_epoch: PositiveInt
    stored_poses: PositiveInt | None
    store: NonEmpty | None
    black_box_poses: PositiveInt


@dataclass(frozen=True)
class NoiseConfig:
    """Noise on the meshes that an inverse is trained on, as of `riginv.sampling.noise.CaptureNoise`."""

    vertex_mm: NonNegativeFloat
    smooth_mm: NonNegativeFloat
    radius_mm: PositiveFloat

    def __bool__(self) -> bool:
        return self.vertex_mm > 0 or self.smooth_mm > 0


@dataclass(frozen=True)
class EvaluationConfig:
    """Meshes in each random test set, and of each set that is validated on while training."""

    test_poses: PositiveInt
    validation_poses: PositiveInt


@dataclass(frozen=True)
class CheckpointConfig:
    """The interval of checkpoints."""

    every_n_steps: PositiveInt


@dataclass(frozen=True)
class PicturesConfig:
    """Pictures of the worst and the median mesh of each set.

    Attributes:
        every_n_validations: how often they are drawn for TensorBoard; None: never.
        final: whether they are drawn at the end, as `poses.png`.
    """

    every_n_validations: PositiveInt | None
    final: bool = True


@dataclass(frozen=True)
class TrainConfig:
    """The config of `riginv.train`; conf/train.yaml explains each key.

    Attributes:
        surrogate: as `model`, plain: it becomes the `model` of another config where a surrogate is trained first.
    """

    rig: ClassSpec[RigBackend]
    true_rig: ClassSpec[RigBackend] | None
    model: ModelConfig
    surrogate: Mapping[str, Any]
    sampler: ClassSpec[MeshSampler]
    trainer: TrainerConfig
    reading: ReadingOptions
    frames: FrameOptions
    seed: NonNegativeInt
    capture: str | None
    data: DataConfig
    mesh_space: MeshSpaceConfig
    noise: NoiseConfig
    evaluation: EvaluationConfig
    checkpoint: CheckpointConfig
    stop_below_lr: PositiveFloat | None
    pictures: PicturesConfig
    resume: bool = False
