"""python -m riginv.compare: every way of inverting a rig side by side, judged by the true rig on the same meshes."""

import time
from typing import Any

import torch
from omegaconf import DictConfig

from riginv.assemble import build_clip, build_rig, build_true_rig
from riginv.build import build
from riginv.cli.command import command, run_directory
from riginv.cli.comparison import read_rows, show, write_rows, write_tables
from riginv.cli.run_folder import find_run_folder, plain_config
from riginv.cli.validation import validate
from riginv.data.mesh_sets import MeshSet
from riginv.data.test_sets import random_sets
from riginv.judge import judge_controls
from riginv.mesh_space import MeshSpace, RigInMeshSpace
from riginv.metrics import nonzero_controls
from riginv.rig import RigBackend

Row = dict[str, Any]


def compare(config: DictConfig) -> None:
    """Run every method on every set, and leave a table, `compare.csv`, `compare.md` and `compare.png` behind."""
    plain = plain_config(config)
    validate(plain)
    folder = find_run_folder(run_directory(), plain, config.resume)
    rig = build_rig(plain)
    true_rig = build_true_rig(plain, rig)
    in_space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    methods = {name: build(method, in_space) for name, method in plain["methods"].items()}
    clip = build_clip(plain, true_rig)
    sets = [*random_sets(true_rig, plain["poses"]), *([clip] if clip else [])]
    folder.begin()
    rows = []
    for name, method in methods.items():
        found = read_rows(folder.path, name)
        if found is None:
            torch.manual_seed(plain["seed"])
            start = time.perf_counter()
            method.prepare(plain["seed"])
            seconds = time.perf_counter() - start
            found = [judged_row(name, method, true_rig, meshes, seconds) for meshes in sets]
            write_rows(folder.path, name, found)
        rows += found
    write_tables(folder.path, rows)
    show(rows, folder.path)


if __name__ == "__main__":
    command("compare")(compare)()
