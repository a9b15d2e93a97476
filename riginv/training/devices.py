"""Ranks of a distributed run (Lightning's DDP, one process for each device), and the config of the trainer.

Processes are started by torchrun, srun, or `riginv.launch.device_launcher`. Only rank 0 prints and writes.
"""

import os
from dataclasses import dataclass
from typing import Literal

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.fabric.plugins.environments import (
    ClusterEnvironment,
    LightningEnvironment,
    LSFEnvironment,
    MPIEnvironment,
    SLURMEnvironment,
    TorchElasticEnvironment,
)
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from riginv.config.values import PositiveInt
from riginv.errors import InputError
from riginv.launch.rank_process import is_rank_process


@dataclass(frozen=True)
class TrainerConfig:
    """The devices and the duration of a training.

    Attributes:
        accelerator: of Lightning: cpu, gpu, auto.
        devices: processes on each machine, one for each device.
        num_nodes: machines.
        max_steps: None: until `stop_below_lr`.
        precision: bf16-mixed: the network computes in bfloat16; the rig and the losses do not.
        threads: number of threads that compute a step on a CPU; auto: one or two, by the number of free cores.
        compile: whether the network is compiled (torch.compile).
        cuda_graphs: whether a training step and a draw on a GPU are captured once as CUDA graphs and replayed.
        deterministic: of Lightning.
        starts_processes: whether the command starts a process for each device; False: they were started from outside.
    """

    accelerator: str
    devices: PositiveInt
    num_nodes: PositiveInt
    max_steps: PositiveInt | None
    precision: Literal["32-true", "bf16-mixed"]
    threads: PositiveInt | Literal["auto"]
    compile: bool
    cuda_graphs: bool
    deterministic: bool | Literal["warn"]
    log_every_n_steps: PositiveInt
    starts_processes: bool

    @property
    def processes(self) -> int:
        """The number of processes of the whole run."""
        return self.devices * self.num_nodes


@dataclass(frozen=True)
class Process:
    """One process of a run.

    Attributes:
        rank: its number; the first, 0, is the one that writes.
        count: of all processes of the run.
        environment: Lightning's description of the other processes; None where there are none, or they have not been started.
    """

    rank: int = 0
    count: int = 1
    environment: ClusterEnvironment | None = None

    @property
    def must_start_others(self) -> bool:
        return self.count > 1 and self.environment is None

    @property
    def shows(self) -> bool:
        """Whether this process prints the result: rank 0, or the process that started the ranks."""
        return self.rank == 0 and not is_rank_process()


def this_process(trainer: TrainerConfig, batch_size: int) -> Process:
    """This process as one of a run, from the config and the environment that started it.

    Args:
        batch_size: meshes in a training batch, those of all processes together.

    Raises:
        InputError: the processes do not match the config, or cannot be started here.
    """
    count = trainer.processes
    if batch_size < count:
        raise InputError(
            f"data.batch_size is {batch_size}, the meshes of all devices together, expected at least one for "
            f"each of the {count} (trainer.devices x trainer.num_nodes)"
        )
    environment = _environment(trainer, count)
    if count > 1 and _is_swept_over(environment):
        raise InputError(
            f"trainer.devices={trainer.devices} cannot be part of a sweep (-m): each job would start its own "
            f"processes, or each process would run the whole sweep; sweep with trainer.devices=1, or with trainer=slurm "
            f"through a launcher that starts all processes of a job (hydra/launcher=submitit_slurm)"
        )
    if environment is None:
        return Process(0, count)
    if environment.world_size() != count and not is_rank_process():
        raise InputError(
            f"{environment.world_size()} processes were started, trainer.devices={trainer.devices} x "
            f"trainer.num_nodes={trainer.num_nodes} is {count}: set both to match the processes"
        )
    rank = int(os.environ["RANK"]) if is_rank_process() else environment.global_rank()
    if count > 1 and not is_rank_process() and not _folder_is_named():
        raise InputError("processes that were started separately need one folder: set hydra.run.dir=DIR, the same for all")
    return Process(rank, count, environment if count > 1 else None)


def _environment(trainer: TrainerConfig, count: int) -> ClusterEnvironment | None:
    """The environment that has started the processes of a run, if any has."""
    if is_rank_process():
        return LightningEnvironment()
    if TorchElasticEnvironment.detect():
        return TorchElasticEnvironment()
    if not trainer.starts_processes:
        return _started_from_outside()
    if count == 1:
        return None
    if trainer.num_nodes > 1:
        raise InputError(
            f"trainer.num_nodes is {trainer.num_nodes}: processes on other machines cannot be started from here; "
            f"use trainer=slurm under srun, or torchrun"
        )
    return None


def _started_from_outside() -> ClusterEnvironment:
    if SLURMEnvironment.detect():
        try:
            return SLURMEnvironment(auto_requeue=False)  # checkpoints and resume=true do it
        except RuntimeError as error:
            raise InputError(f"trainer.starts_processes=false: {str(error).splitlines()[0]}") from None
    for kind in (LSFEnvironment, MPIEnvironment):
        if kind.detect():
            return kind()
    raise InputError(
        "trainer.starts_processes=false (as of trainer=slurm) finds no processes: start the command with srun, or choose "
        "trainer=ddp, which starts them"
    )


def _is_swept_over(environment: ClusterEnvironment | None) -> bool:
    """Whether a sweep's job would have to start processes, or each process would run the whole sweep."""
    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return False
    return environment is None or HydraConfig.get().launcher._target_.endswith(".BasicLauncher")


def _folder_is_named() -> bool:
    if not HydraConfig.initialized() or HydraConfig.get().mode == RunMode.MULTIRUN:
        return True
    return any(override.startswith("hydra.run.dir=") for override in HydraConfig.get().overrides.hydra)


def is_distributed() -> bool:
    """Whether several processes train together."""
    return torch.distributed.is_available() and torch.distributed.is_initialized()


def leave_process_group() -> None:
    """Destroy the process group after training: only rank 0 evaluates."""
    if is_distributed():
        torch.distributed.destroy_process_group()


def all_reduce_means(means: Tensor, count: int) -> tuple[Tensor, float]:
    """Means over the meshes of all processes, from those over the `count` meshes of this one.

    Returns:
        The means, and the factor for this process's loss: DDP averages gradients with equal weights, so losses of larger parts
        of the batch are weighted up.
    """
    sums = torch.cat([means.double() * count, means.new_tensor([count], dtype=torch.float64)])
    torch.distributed.all_reduce(sums)
    total = sums[-1]
    return (sums[:-1] / total).to(means.dtype), float(count * torch.distributed.get_world_size() / total)


def check_normalisation(network: nn.Module, device: torch.device) -> None:
    """Raises InputError where a network normalises over batches that processes on CPUs would each see a part of."""
    if device.type == "cpu" and any(isinstance(part, _BatchNorm) for part in network.modules()):
        raise InputError(
            "the network normalises over a batch, which several processes on CPUs cannot share: use trainer.devices=1"
        )
