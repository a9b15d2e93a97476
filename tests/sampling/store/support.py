"""Stores of a toy, and what is told of them."""

from pathlib import Path

import numpy as np
import zarr

from riginv.config.typed import to_typed
from riginv.sampling.store.filling import SampleConfig, fill
from riginv.sampling.store.store import PoseStore

SPARSE = {
    "_target_": "riginv.sampling.meshes.RigPoses",
    "controls": {"_target_": "riginv.sampling.controls.SparseControls", "max_active": None},
}
PLAN = {
    "rig": {"_target_": "tests.support.toys.ToyRig"},
    "sampler": SPARSE,
    "samples": 250,
    "seed": 3,
    "shard": "0/1",
    "dtype": "float32",
    "vertices": False,
    "chunk": 20,
    "jobs": 1,
    "recheck": True,
    "mesh_space": {"samples": 40, "residual_mm": 0.01},
}


def plan(values: dict) -> SampleConfig:
    return to_typed(values, SampleConfig)


def filled(out: Path | str, **changes) -> PoseStore:
    return fill(plan({**PLAN, "out": str(out), **changes})).store


def arrays(path: Path) -> dict[str, np.ndarray]:
    group = zarr.open_group(path, mode="r")
    return {name: group[name][:] for name in group.array_keys()}


def same(one: Path, other: Path) -> bool:
    a, b = arrays(one), arrays(other)
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
