"""What stores cost and give: sampling against the rig's own time, poses a second, shards, and reading against training.

    python benchmarks/sampling.py [--samples 1000000] [--folder DIR] [--steps 100]

Every ratio is of figures from this one run. The stores are made under DIR (a new folder in the system's temporary one unless
given; about 0.8 GB for a million poses of the face) and removed in the end.
"""

import argparse
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from rich.console import Console
from rich.table import Table

from riginv.config.messages import CONFIGS
from riginv.config.typed import to_typed
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.sampling.store.filling import SampleConfig, plan_store
from riginv.sampling.store.location import StoreLocation
from riginv.sampling.store.making import ChunkMaker, build_sampler
from riginv.sampling.store.store import PoseStore
from riginv.sampling.store.windows import WindowReader
from riginv.training.assembly import build_module, calibrate
from riginv.training.assembly import build_sampler as build_sampler_of
from riginv.training.config import TrainConfig
from rigs.face import FaceRig

SLOW_POSES, SLOW_RATE, BATCH = 2048, 200, 64
PLAN = {
    "rig": {"_target_": "rigs.face.FaceRig"},
    "sampler": {
        "_target_": "riginv.sampling.meshes.RigPoses",
        "controls": {"_target_": "riginv.sampling.controls.SparseControls", "max_active": None},
    },
    "seed": 0,
    "dtype": "float32",
    "vertices": False,
    "chunk": None,
    "shard": "0/1",
    "jobs": 1,
    "recheck": True,
    "mesh_space": {"samples": 1000, "residual_mm": 0.01},
}


class SlowFace(FaceRig):
    """The face, held to 200 poses a second, which keeps account of its own time."""

    differentiable = False

    def __init__(self) -> None:
        super().__init__()
        self.spent = 0.0

    def coefficients(self, controls: torch.Tensor) -> torch.Tensor:
        began = time.perf_counter()
        found = super().coefficients(controls)
        time.sleep(max(0.0, len(controls) / SLOW_RATE - (time.perf_counter() - began)))
        self.spent += time.perf_counter() - began
        return found


def overhead(folder: Path) -> float:
    """The time that sampling takes beyond the rig's own, as a share of that, of a rig of 200 poses a second."""
    rig = SlowFace()
    settings = to_typed({**PLAN, "samples": SLOW_POSES}, SampleConfig)
    layout, facts = plan_store(settings, rig)
    store = PoseStore.begin(StoreLocation(str(folder / "slow.zarr")), layout, facts, rig)
    maker = ChunkMaker(store, rig, build_sampler(settings.sampler.config, rig))
    rig.spent, began = 0.0, time.perf_counter()
    for chunk in range(layout.chunks):
        maker.make(chunk)
    return (time.perf_counter() - began) / rig.spent - 1


def command(name: str, *arguments: str) -> subprocess.Popen:
    """A command of riginv's, started."""
    return subprocess.Popen([sys.executable, "-m", f"riginv.{name}", *arguments], stdout=subprocess.DEVNULL)


def seconds_of(*running: subprocess.Popen) -> float:
    """How long it takes until all have ended."""
    began = time.perf_counter()
    for process in running:
        if process.wait():
            sys.exit(f"{process.args!r} failed")
    return time.perf_counter() - began


def steady(store: Path, layout_chunk: int) -> float:
    """Poses a second between the first and the last chunk of a store: without the start of the processes."""
    times = sorted(path.stat().st_mtime for path in (store / "ledger/c").glob("*/0"))
    return (len(times) - 1) * layout_chunk / (times[-1] - times[0])


def training_speed(model: str, store: Path, steps: int) -> dict[str, float]:
    """Poses a second that training steps take, drawn as they go and from a store, turn by turn."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        settings = to_typed(compose("train", [f"model={model}"]), TrainConfig)
    rig = FaceRig()
    module = build_module(settings, RigInMeshSpace(rig, MeshSpace.from_rig(rig)), rig)
    drawn = build_sampler_of(settings, module.rig)
    calibrate(settings.seed, module, drawn)
    settings = replace(settings, data=replace(settings.data, store=str(store)))
    samplers = {"drawn": drawn, "stored": build_sampler_of(settings, module.rig)}
    optimizer = module.configure_optimizers()["optimizer"]
    spent = dict.fromkeys(samplers, 0.0)
    for step in range(steps + 2):
        for name, sampler in samplers.items():
            began = time.perf_counter()
            sampler.at_step(step)
            loss = module.training_step(sampler.sample(BATCH, generator_at(0, "training", step)), 0)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            if step >= 2:  # the first two warm up
                spent[name] += time.perf_counter() - began
    return {name: steps * BATCH / seconds for name, seconds in spent.items()}


def read(store: PoseStore) -> float:
    """Poses a second that training's reader gives, in batches of 64, over a whole epoch."""
    reader, began = WindowReader(store, seed=0), time.perf_counter()
    for start in range(0, store.layout.samples - BATCH + 1, BATCH):
        reader.poses(start, BATCH)
    return store.layout.samples / (time.perf_counter() - began)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000, help="poses of the store that is read and trained on")
    parser.add_argument("--shard-samples", type=int, default=2_000_000, help="poses where processes are compared")
    parser.add_argument("--steps", type=int, default=100, help="training steps that are timed")
    parser.add_argument("--folder", type=Path, default=None)
    given = parser.parse_args()
    rows = Table("what", "measured", "asked for")

    def say(*row: str) -> None:
        rows.add_row(*row)
        print(": ".join(row), flush=True)

    warnings.filterwarnings("ignore", ".*self.trainer.*")
    with tempfile.TemporaryDirectory(dir=given.folder) as temporary:
        folder = Path(temporary)
        say(f"store's overhead at {SLOW_RATE} poses/s", f"{overhead(folder):.1%}", "<= 10 %")

        few = f"samples={given.shard_samples}"
        one = seconds_of(command("sample", few, "jobs=1", f"out={folder / 'one.zarr'}"))
        shards = [command("sample", few, "jobs=1", f"shard={n}/2", f"out={folder / 'two.zarr'}") for n in range(2)]
        two = seconds_of(*shards)
        say(f"one process, {given.shard_samples:,} poses", f"{given.shard_samples / one:,.0f} poses/s", "")
        say("two shards in two processes", f"{given.shard_samples / two:,.0f} poses/s: {one / two:.2f} x", ">= 1.6 x")

        store = folder / "poses.zarr"
        whole = seconds_of(command("sample", f"samples={given.samples}", f"out={store}"))
        opened = PoseStore.find(StoreLocation(str(store)))
        assert opened is not None
        rate = steady(store, opened.layout.chunk)
        said = f"{given.samples / whole:,.0f} poses/s with the start, {rate:,.0f} without"
        say(f"the face, {given.samples:,} poses, a process for each core", said, ">= 20,000 on 2 cores")
        size = sum(path.stat().st_size for path in store.rglob("*") if path.is_file())
        say("size of that store", f"{size / 1e9:.2f} GB", "")

        speed = read(opened)
        for model in ("forward", "inverse"):
            taken = training_speed(model, store, given.steps)
            ratio = f"{speed:,.0f} poses/s, training takes {taken['drawn']:,.0f}: {speed / taken['drawn']:.0f} x"
            say(f"reading it, against model={model}", ratio, ">= 5 x")
            say("its steps from the store, against drawn ones", f"{taken['stored'] / taken['drawn']:.2f} x", ">= 1 x")
    Console(width=140).print(rows)


if __name__ == "__main__":
    main()
