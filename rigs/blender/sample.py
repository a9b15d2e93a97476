"""python -m rigs.blender.sample: poses of a rig as a table of pairs of controls and vertices, to train on without the rig.

The table is an .npz, or a folder of .npy files, with the arrays controls `(pose, control)` and vertices `(pose, vertex, 3)`,
mm, float32; rest_vertices `(vertex, 3)`; faces `(face, 3)`; control_names, lower, upper, neutral `(control,)`.
"""

from riginv.launch.command import answer_help, command

answer_help(__name__, "sample_blender")  # before the imports that take seconds

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig
from rich.progress import track

from riginv.config.building import ClassSpec
from riginv.config.typed import to_typed
from riginv.config.values import NonNegativeInt, PositiveInt
from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.interface import RigBackend
from riginv.rig.random_controls import sparse_controls
from riginv.runs.console import show_result
from riginv.runs.files import atomic_write, discard, free_file
from riginv.runs.locks import exclusive_lock

BATCH_SIZE = 128  # poses at a time


@dataclass(frozen=True)
class PairsConfig:
    """The config of `rigs.blender.sample`; conf/sample_blender.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    out: str
    poses: PositiveInt
    most: int | None
    seed: NonNegativeInt


def sample(config: DictConfig) -> None:
    """Draw poses of `config.rig` and write them to `config.out`."""
    settings = to_typed(config, PairsConfig)
    out = Path(settings.out)
    if out.suffix not in ("", ".npz"):
        raise InputError(f"out={out}: expected a name that ends in .npz, or without an ending for a folder of .npy files")
    free_file(settings.out)
    rig = settings.rig.build()
    most = len(rig.controls) if settings.most is None else settings.most
    if not 1 <= most <= len(rig.controls):
        raise InputError(f"most is {most}, expected 1 to {len(rig.controls)}, the number of controls of '{rig.name}'")
    generator = generator_at(settings.seed, "pairs")
    controls = sparse_controls(rig.lower, rig.upper, rig.neutral_controls, most, settings.poses, generator)
    write_pairs(rig, controls, out)
    show_result(f"{out}: {len(controls)} poses of rig '{rig.name}', up to {most} controls at a time")


@torch.no_grad()
def write_pairs(rig: RigBackend, controls: torch.Tensor, out: Path) -> None:
    """Write the poses of controls `(pose, control)` as a table of pairs, atomically."""
    arrays: dict[str, Any] = {
        "controls": controls.numpy().astype(np.float32),
        "rest_vertices": rig.rest_vertices.numpy(),
        "faces": rig.faces.numpy(),
        "control_names": np.array(rig.control_names),
        "lower": rig.lower.numpy(),
        "upper": rig.upper.numpy(),
        "neutral": rig.neutral_controls.numpy(),
    }
    shape = (len(controls), *rig.rest_vertices.shape)
    with exclusive_lock(out), atomic_write(out) as partial, contextlib.ExitStack() as stack:
        folder = partial
        if out.suffix:
            folder = partial.with_name(f"{partial.name}.arrays")
            stack.callback(discard, folder)
        folder.mkdir()
        vertices = np.lib.format.open_memmap(folder / "vertices.npy", "w+", np.float32, shape)
        for start in track(range(0, len(controls), BATCH_SIZE), "poses", transient=True):
            vertices[start : start + BATCH_SIZE] = rig(controls[start : start + BATCH_SIZE]).numpy()
        vertices.flush()
        if not out.suffix:
            for name, array in arrays.items():
                np.save(folder / f"{name}.npy", array)
            return
        with partial.open("wb") as file:
            np.savez(file, vertices=vertices, **arrays)


if __name__ == "__main__":
    command("sample_blender")(sample)()
