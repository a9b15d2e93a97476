"""What stores cost and give: sampling against the rig's own time, poses a second, shards, and reading against training.

    python benchmarks/sampling.py [--samples 1000000] [--folder DIR] [--steps 300]

Every ratio is of figures from this one run. The stores are made under DIR (a new folder in the system's temporary one unless
given; about 1.5 GB for a million poses of the face) and removed in the end.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from riginv.store.filling import planned
from riginv.store.making import ChunkMaker, build_sampler
from riginv.store.place import Place
from riginv.store.store import PoseStore
from riginv.store.windows import WindowReader
from rigs.face import FaceRig

SLOW_POSES, SLOW_RATE = 2048, 200
PLAN = {
    "rig": {"_target_": "rigs.face.FaceRig"},
    "sampler": {
        "_target_": "riginv.sampling.meshes.RigPoses",
        "controls": {"_target_": "riginv.sampling.controls.SparseControls", "most": None},
    },
    "seed": 0,
    "dtype": "float32",
    "vertices": False,
    "chunk": None,
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
    layout, facts = planned({**PLAN, "samples": SLOW_POSES}, rig)
    store = PoseStore.begin(Place(str(folder / "slow.zarr")), layout, facts, rig)
    maker = ChunkMaker(store, rig, build_sampler(PLAN["sampler"], rig))
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
            sys.exit(f"{process.args} failed")
    return time.perf_counter() - began


def steady(store: Path, layout_chunk: int) -> float:
    """Poses a second between the first and the last chunk of a store: without the start of the processes."""
    times = sorted(path.stat().st_mtime for path in (store / "ledger/c").glob("*/0"))
    return (len(times) - 1) * layout_chunk / (times[-1] - times[0])


def trained(folder: Path, model: str, steps: int, *more: str) -> float:
    """Poses a second that training takes."""
    small = ["judging.test_poses=20", "judging.validation_poses=4", "pictures.every_n_validations=null"]
    run = folder / f"{model}-{len(more)}"
    seconds_of(
        command(
            "train", f"model={model}", f"trainer.max_steps={steps}", *small, *more, f"hydra.run.dir={run}", "data.batch_size=64"
        )
    )
    metrics = json.loads((run / "metrics.json").read_text())
    return metrics["train/steps"] * 64 / metrics["train/seconds"]


def read(store: PoseStore) -> float:
    """Poses a second that training's reader gives, in batches of 64, over a whole epoch."""
    reader, began = WindowReader(store, seed=0), time.perf_counter()
    for start in range(0, store.layout.samples - 63, 64):
        reader.poses(start, 64)
    return store.layout.samples / (time.perf_counter() - began)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000, help="poses of the store that is read and trained on")
    parser.add_argument("--shard-samples", type=int, default=400_000, help="poses where processes are compared")
    parser.add_argument("--steps", type=int, default=300, help="training steps that are timed")
    parser.add_argument("--folder", type=Path, default=None)
    given = parser.parse_args()
    table = Table("what", "measured", "asked for")
    with tempfile.TemporaryDirectory(dir=given.folder) as temporary:
        folder = Path(temporary)
        table.add_row(f"store's overhead at {SLOW_RATE} poses/s", f"{overhead(folder):.1%}", "<= 10 %")

        few = f"samples={given.shard_samples}"
        one = seconds_of(command("sample", few, "jobs=1", f"out={folder / 'one.zarr'}"))
        shards = [command("sample", few, "jobs=1", f"shard={n}/2", f"out={folder / 'two.zarr'}") for n in range(2)]
        two = seconds_of(*shards)
        table.add_row(f"one process, {given.shard_samples:,} poses", f"{given.shard_samples / one:,.0f} poses/s", "")
        table.add_row("two shards in two processes", f"{given.shard_samples / two:,.0f} poses/s: {one / two:.2f} x", ">= 1.6 x")

        store = folder / "poses.zarr"
        whole = seconds_of(command("sample", f"samples={given.samples}", f"out={store}"))
        opened = PoseStore.find(Place(str(store)))
        rate = steady(store, opened.layout.chunk)
        said = f"{given.samples / whole:,.0f} poses/s with the start, {rate:,.0f} without"
        table.add_row(f"the face, {given.samples:,} poses, a process for each core", said, ">= 20,000 on 2 cores")
        size = sum(path.stat().st_size for path in store.rglob("*") if path.is_file())
        table.add_row("size of that store", f"{size / 1e9:.2f} GB", "")

        speed = read(opened)
        for model in ("forward", "inverse"):
            drawn, stored = (trained(folder, model, given.steps, *more) for more in ([], [f"data.store={store}"]))
            table.add_row(
                f"reading it, against model={model}",
                f"{speed:,.0f} poses/s, training takes {drawn:,.0f}: {speed / drawn:.0f} x; from the store {stored:,.0f}",
                ">= 5 x",
            )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
