"""Which of a run's processes this one is: on several devices a run is one process for each (Lightning's DDP).

torchrun and srun start them; where nothing has, `riginv.cli.starter` does. The first process is the one that prints and writes.
"""

import os
from dataclasses import dataclass
from typing import Any

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

from riginv.cli.watched import is_watched
from riginv.errors import InputError


@dataclass(frozen=True)
class Process:
    """One process of a run.

    Attributes:
        rank: its number; the first, 0, is the one that writes.
        count: of all processes of the run.
        environment: where Lightning learns of the others; None where there are none, or they are still to be started.
    """

    rank: int = 0
    count: int = 1
    environment: ClusterEnvironment | None = None

    @property
    def must_start_others(self) -> bool:
        return self.count > 1 and self.environment is None

    @property
    def shows(self) -> bool:
        """Whether it shows the result: the first does, or the one that has started it."""
        return self.rank == 0 and not is_watched()


def this_process(config: dict[str, Any]) -> Process:
    """Which process of a run this one is, from its plain config and from what has started it.

    Raises:
        InputError: the processes that are there are not those that the config asks for, or cannot be started here.
    """
    trainer = config["trainer"]
    count = trainer["devices"] * trainer["num_nodes"]
    if config["data"]["batch_size"] < count:
        raise InputError(
            f"data.batch_size is {config['data']['batch_size']}, the meshes of all devices together, expected at least one for "
            f"each of the {count} (trainer.devices x trainer.num_nodes)"
        )
    environment = _environment(trainer, count)
    if count > 1 and _is_swept_over(environment):
        raise InputError(
            f"trainer.devices={trainer['devices']} cannot be part of a sweep (-m): every job would start processes of its own, "
            f"beside those of the sweep, or each of these the whole sweep; sweep with trainer.devices=1, or with trainer=slurm "
            f"through a launcher that starts all processes of a job (hydra/launcher=submitit_slurm)"
        )
    if environment is None:
        return Process(0, count)
    if environment.world_size() != count and not is_watched():
        raise InputError(
            f"{environment.world_size()} processes were started, trainer.devices={trainer['devices']} x "
            f"trainer.num_nodes={trainer['num_nodes']} asks for {count}: give both as they were started"
        )
    rank = int(os.environ["RANK"]) if is_watched() else environment.global_rank()
    if count > 1 and not is_watched() and not _folder_is_named():
        raise InputError(
            "several processes that were started apart need one folder: name it with hydra.run.dir=DIR, the same for all"
        )
    return Process(rank, count, environment if count > 1 else None)


def _environment(trainer: dict[str, Any], count: int) -> ClusterEnvironment | None:
    """What has started the processes of a run, if anything has."""
    if is_watched():
        return LightningEnvironment()
    if TorchElasticEnvironment.detect():
        return TorchElasticEnvironment()
    if not trainer["starts_processes"]:
        return _started_from_outside()
    if count == 1:
        return None
    if trainer["num_nodes"] > 1:
        raise InputError(
            f"trainer.num_nodes is {trainer['num_nodes']}: processes on other machines cannot be started from here; "
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
    """Whether the processes of a run would have to come of a job of a sweep, or each go through the whole sweep."""
    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return False
    return environment is None or HydraConfig.get().launcher._target_.endswith(".BasicLauncher")


def _folder_is_named() -> bool:
    if not HydraConfig.initialized() or HydraConfig.get().mode == RunMode.MULTIRUN:
        return True
    return any(override.startswith("hydra.run.dir=") for override in HydraConfig.get().overrides.hydra)
