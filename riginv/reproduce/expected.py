"""The expected time of a budget, from training steps that are timed before it starts."""

import statistics
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import lightning as L

from riginv.rig.mesh_space import RigInMeshSpace
from riginv.training.assembly import build_module, build_sampler, calibrate, lightning_arguments
from riginv.training.config import TrainConfig
from riginv.training.data import PoseDataModule, bare_trainer

WARM, TIMED = 3, 8  # steps
THROUGH = 0.6  # additional time of a training step through a surrogate, relative to a training step of the surrogate


class StepClock(L.Callback):
    """Records when each step ended."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def on_train_batch_end(self, *args: Any) -> None:
        self.times.append(time.perf_counter())

    @property
    def step_s(self) -> float:
        gaps = [later - earlier for earlier, later in zip(self.times, self.times[1:])]
        return statistics.median(gaps[WARM:])


def measured_step_s(settings: TrainConfig, rig: RigInMeshSpace) -> float:
    """Seconds per training step on this machine: the median of a few, after some to warm up."""
    settings = replace(settings, data=replace(settings.data, stored_poses=None))
    module = build_module(settings, rig, rig.source)
    sampler = build_sampler(settings, rig)
    calibrate(settings.seed, module, sampler)
    clock, steps = StepClock(), WARM + TIMED + 1
    trainer = bare_trainer(**{**lightning_arguments(settings.trainer), "max_steps": steps}, callbacks=[clock])
    trainer.fit(module, PoseDataModule(sampler, {}, settings.data.batch_size, steps + 1, settings.seed))
    return clock.step_s


def measured(trainings: Mapping[str, TrainConfig], rig: RigInMeshSpace) -> dict[str, float]:
    """Seconds per training step of each network, by name; that through a trained rig is estimated from two others."""
    step_s = {name: measured_step_s(training, rig) for name, training in trainings.items()}
    return {**step_s, "trained": step_s["inverse"] + THROUGH * step_s["surrogate"]}
