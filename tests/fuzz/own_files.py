"""Files that riginv writes itself, to be damaged: bundles, checkpoints, run folders, caches, configs."""

import functools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from riginv.clips.vertex_map import read_vertex_map
from riginv.config.folders import check_folder
from riginv.inference.inverse import load_inverse
from riginv.methods.comparison import HEADINGS, keep_rows, kept_rows, write_tables
from riginv.reproduce.inversion import read_controls
from riginv.reproduce.steps import read_done, write_done
from riginv.runs.cache import cached_tensors
from riginv.runs.run_folder import RunFolder, find_run_folder
from riginv.tracking.control_names import read_mask
from riginv.tracking.regions import read_region
from riginv.training.checkpoints import AtomicCheckpoints
from riginv.training.summary import show
from tests.fuzz.bundles import write_tiny_bundle, write_tiny_checkpoint
from tests.fuzz.tally import Target
from tests.inference.test_bundle import rewrite_sums
from tests.support.toys import ToyRig

Make = Callable[[Path], Target]


@functools.lru_cache(maxsize=1)
def toy() -> ToyRig:
    return ToyRig(detail=1, arkit=True)


def _bundle(signed: bool) -> Make:
    """`signed`: with checksums that fit, as who means harm would leave it."""

    def make(folder: Path) -> Target:
        bundle = write_tiny_bundle(folder / "bundle")
        rest = toy().rest_vertices[None]

        def read() -> None:
            assert load_inverse(bundle, toy())(rest).shape == (1, 7)

        victims = [path for path in _files(bundle) if not signed or path.name != "SHA256SUMS"]
        return Target(victims, read, (lambda: rewrite_sums(bundle)) if signed else (lambda: None))

    return make


def _checkpoint(folder: Path) -> Target:
    path = write_tiny_checkpoint(folder / "last.ckpt")
    return Target([path], lambda: AtomicCheckpoints().load_checkpoint(path))


def _run_folder(folder: Path) -> Target:
    config = {"seed": 0, "model": {"hidden": [8, 8], "lr": 1e-3, "name": "x"}, "capture": None}
    RunFolder(folder / "run", config, resumed=False).begin()
    return Target([folder / "run/config.yaml"], lambda: find_run_folder(folder / "run", config, resume=True))


def _results(folder: Path) -> Target:
    metrics = {"train/steps": 5, "train/seconds": 1.5, "true_rig": "toy", "rig_poses/mean_vertex_error_mm": 0.5}
    for key in ("neutral_mean_vertex_error_mm", "mean_of_max_vertex_error_mm", "max_vertex_error_mm"):
        metrics[f"rig_poses/{key}"] = 1.0
    (folder / "metrics.json").write_text(json.dumps(metrics, indent=1))
    return Target([folder / "metrics.json"], lambda: show(RunFolder(folder, {}, True), "rigs.face.FaceRig"))


def _kept_methods(folder: Path) -> Target:
    row = {**dict.fromkeys(HEADINGS, 1.0), "method": "neutral", "set": "rig_poses", "optimum_mm": 1.0}
    keep_rows(folder, "neutral", {"config": {}, "fingerprint": "f", "source": "none"}, [row])

    def read() -> None:
        kept_rows(folder, "neutral", {"config": {}})
        write_tables(folder)

    return Target([folder / "methods/neutral.json"], read)


def _kept_step(folder: Path) -> Target:
    write_done(folder, 1.0, {"figure": 1.0})
    return Target([folder / "done.json"], lambda: read_done(folder))


def _step_tensors(folder: Path) -> Target:
    from safetensors.torch import save_file

    save_file({"clip": torch.rand(3, 4)}, folder / "controls.safetensors")
    return Target([folder / "controls.safetensors"], lambda: read_controls(folder))


def _cache(folder: Path) -> Target:
    def read() -> None:
        found = cached_tensors("fuzz", "key", lambda: {"a": torch.arange(6.0)})
        assert found["a"].shape == (6,)

    read()
    from riginv.runs.cache import cache_folder

    return Target([cache_folder() / "fuzz-key.safetensors"], read)


def _masks(folder: Path) -> Target:
    (folder / "m.json").write_text(json.dumps({"bump0": 1, "side": 0.5}))
    (folder / "m.yaml").write_text("bump0: 1\nside: 0.5\n")
    (folder / "m.csv").write_text("bump0,1\nside,0.5\n")
    return Target(_files(folder), lambda: [read_mask(path) for path in _files(folder)])


def _regions(folder: Path) -> Target:
    (folder / "r.json").write_text("[1, 2, 3]")
    (folder / "r.txt").write_text("1, 2, 3\n4 5\n")
    np.save(folder / "r.npy", np.linspace(0, 1, 42).astype(np.float32))
    return Target(_files(folder), lambda: [read_region(path, 42) for path in _files(folder)])


def _picked(folder: Path) -> Target:
    (folder / "p.txt").write_text("0 1 2 -1\n")
    np.save(folder / "p.npy", np.arange(4))
    return Target(_files(folder), lambda: [read_vertex_map(path, 42) for path in _files(folder)])


def _configs(folder: Path) -> Target:
    (folder / "rig").mkdir()
    (folder / "rig/mine.yaml").write_text(
        "# @package _global_\ndefaults:\n  - face\nrig:\n  _target_: rigs.face.FaceRig\n  x: 1\n"
    )
    return Target([folder / "rig/mine.yaml"], lambda: check_folder(folder))


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())
