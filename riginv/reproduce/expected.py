"""How long a budget will take: from training steps that are measured here, before any work starts."""

import statistics
import time
from dataclasses import replace
from typing import Any

import lightning as L

from riginv.config.typed import to_typed
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.training.assembly import build_module, build_sampler, calibrate, lightning_arguments
from riginv.training.config import TrainConfig
from riginv.training.data import PoseDataModule

WARM, TIMED = 3, 8  # steps
THROUGH = 0.6  # of a surrogate's training step: what a step through one takes more


class StepClock(L.Callback):
    """Keeps when each step ended."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def on_train_batch_end(self, *args: Any) -> None:
        self.times.append(time.perf_counter())

    @property
    def step_s(self) -> float:
        gaps = [later - earlier for earlier, later in zip(self.times, self.times[1:])]
        return statistics.median(gaps[WARM:])


def measured_step_s(settings: TrainConfig, rig: RigInMeshSpace) -> float:
    """What a training step takes here, s: the median of a few, after some to warm up."""
    settings = replace(settings, data=replace(settings.data, stored_poses=None))
    module = build_module(settings, rig, rig.rig)
    sampler = build_sampler(settings, rig)
    calibrate(settings.seed, module, sampler)
    clock, steps = StepClock(), WARM + TIMED + 1
    trainer = L.Trainer(
        **{**lightning_arguments(settings.trainer), "max_steps": steps},
        max_epochs=-1,
        callbacks=[clock],
        logger=False,
        enable_checkpointing=False,
        enable_model_summary=False,
        enable_progress_bar=False,
        num_sanity_val_steps=0,
        limit_val_batches=0,
    )
    trainer.fit(module, PoseDataModule(sampler, {}, settings.data.batch_size, steps + 1, settings.seed))
    return clock.step_s


def measured(trainings: dict[str, dict[str, Any]], rig: RigInMeshSpace) -> dict[str, float]:
    """What a training step of each network takes, s, by name; through a trained rig it is reckoned."""
    step_s = {name: measured_step_s(to_typed(config, TrainConfig), rig) for name, config in trainings.items()}
    return {**step_s, "trained": step_s["inverse"] + THROUGH * step_s["surrogate"]}
