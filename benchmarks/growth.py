"""The cost of a training step as vertices grow 10 times, and as controls grow 4 times; on blendshape rigs made for it.

    python -m benchmarks.growth [--rounds 40] [--threads 2] [--out growth.png]

The step is that of `riginv.train model=inverse`: the default network, losses and optimiser on batches of 64. All rigs take
turns, so that a machine that slows down slows all of them; the median of their times counts.
"""

import argparse
import statistics
import time
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from riginv.geometry.blendshapes import combination_weights
from riginv.networks.inverse import StagedInverse
from riginv.rig.batches import generator_at
from riginv.rig.interface import Control, LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.runs.threads import Workers, single_threaded
from riginv.sampling.meshes import RandomCombinations
from riginv.training.inverse import InverseModule
from riginv.training.losses import RmsVertexDistanceLoss

VERTICES, CONTROLS = (4_000, 10_000, 20_000, 40_000), (50, 100, 150, 200)  # one grows while the other is its first
BATCH, REACH, WARM_UP = 64, 0.15, 3  # meshes; size of a shape, of the mesh's; rounds that are not counted


class MadeRig(LinearRig):
    """A sheet with a local shape for each control, and combinations of as many neighbouring pairs."""

    members: Tensor

    def __init__(self, vertices: int, controls: int) -> None:
        draw = torch.Generator().manual_seed(0)
        rest = torch.rand(vertices, 3, generator=draw) * torch.tensor([100.0, 100.0, 10.0])
        centres = rest[torch.randint(vertices, (2 * controls,), generator=draw)]
        falloff = torch.exp(-(torch.cdist(centres, rest) / (100 * REACH)).square())
        basis = falloff[..., None] * torch.randn(2 * controls, 1, 3, generator=draw)
        limits = [Control(f"control_{number}", 0.0, 1.0, 0.0) for number in range(controls)]
        super().__init__("made", limits, rest, torch.tensor([[0, 1, 2]]), basis, primary_count=controls)
        pairs = torch.stack([torch.arange(controls), torch.arange(1, controls + 1) % controls], dim=1)
        self.register_buffer("members", pairs, persistent=False)

    def coefficients(self, controls: Tensor) -> Tensor:
        return torch.cat([controls, combination_weights(controls, self.members)], dim=1)


class Run:
    """The training of the default inverse of a made rig, step by step."""

    def __init__(self, vertices: int, controls: int, threads: int) -> None:
        rig = MadeRig(vertices, controls)
        in_space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
        self.sampler, self.step, self.milliseconds = RandomCombinations(in_space), 0, list[float]()
        network = StagedInverse(in_space)
        network.calibrate(self._batch()["coordinates"])
        adam = partial(torch.optim.Adam, lr=1e-3, fused=True)
        constant = partial(torch.optim.lr_scheduler.ConstantLR, factor=1.0)
        self.module = InverseModule(in_space, network, RmsVertexDistanceLoss(vertices), adam, constant, sampled_vertices=512)
        self.module.workers, self.module.log = Workers(threads), lambda *args, **kwargs: None  # there is no trainer to log to
        self.optimizer = self.module.configure_optimizers()["optimizer"]

    def advance(self) -> None:
        """Take a step and record its time."""
        began = time.perf_counter()
        loss = self.module.training_step(self._batch(), self.step)
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self.milliseconds.append(1e3 * (time.perf_counter() - began))

    def _batch(self) -> dict[str, Tensor]:
        self.step += 1
        return self.sampler.sample(BATCH, generator_at(0, "growth", self.step))


def plot(path: Path, grown: dict[str, list[tuple[int, float]]]) -> None:
    """A picture of the cost of a step, relative to the smallest rig, against vertices and against controls."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    for axes, (name, rows) in zip(figure.subplots(1, 2, sharey=True), grown.items()):
        axes.plot([size for size, _ in rows], [cost / rows[0][1] for _, cost in rows], marker="o")
        axes.set(xlabel=name, xticks=[size for size, _ in rows], xticklabels=[f"{size:,}" for size, _ in rows])
        axes.grid(alpha=0.3)
    figure.axes[0].set(ylabel="cost of a training step", ylim=(0, 2))
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path, help="a PNG of the table")
    given = parser.parse_args()
    sizes = dict.fromkeys([*((vertices, CONTROLS[0]) for vertices in VERTICES), *((VERTICES[0], count) for count in CONTROLS)])
    with single_threaded():
        runs = {size: Run(*size, given.threads) for size in sizes}
        for _ in range(WARM_UP + given.rounds):
            for run in runs.values():
                run.advance()
    cost = {size: statistics.median(run.milliseconds[WARM_UP:]) for size, run in runs.items()}
    print("| vertices | controls | ms a step | relative |\n|---|---|---|---|")
    for (vertices, controls), median in cost.items():
        print(f"| {vertices:,} | {controls} | {median:.1f} | {median / cost[VERTICES[0], CONTROLS[0]]:.2f} |")
    if given.out:
        by_vertices = [(vertices, cost[vertices, CONTROLS[0]]) for vertices in VERTICES]
        plot(given.out, {"vertices": by_vertices, "controls": [(count, cost[VERTICES[0], count]) for count in CONTROLS]})


if __name__ == "__main__":
    main()
