"""How much faster a training step is in mesh coordinates than on full meshes; both are timed in one run, taking turns.

    python benchmarks/training_step.py [--rounds 15] [--batch 64]

The step on full meshes is the same step with the same network from the first hidden layer on: meshes made by the full linear
map, as many inputs as coordinates of vertices, the loss on all vertices. A third step is in the mesh coordinates of a face
with ten times the vertices.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import torch
from torch import Tensor, nn

from riginv.networks.control_maps import RangeTanh
from riginv.networks.inverse import DirectInverse
from riginv.networks.mlp import mlp
from riginv.networks.surrogate import ControlMLP
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.sampling.controls import SparseControls
from riginv.sampling.meshes import random_weights
from rigs.face import FaceRig

HIDDEN = (2048, 1024, 512, 256)
Step = Callable[[], None]


class LargerFace(FaceRig):
    """The face with every vertex ten times: the same logic, ten times the mesh."""

    def __init__(self) -> None:
        super().__init__()
        self.rest_vertices = self.rest_vertices.repeat(10, 1)
        self.basis = self.basis.repeat(1, 10, 1)


def learn(network: nn.Module, loss: Callable[[], Tensor]) -> Step:
    """A training step: the loss, its gradients, and Adam at the paper's rate."""
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-4, fused=True)

    def step() -> None:
        optimizer.zero_grad()
        loss().backward()
        optimizer.step()

    return step


def inverse_in_mesh_space(rig: RigInMeshSpace, batch: int) -> Step:
    """Random combinations in mesh coordinates, the paper's network, the loss on the rig's coordinates."""
    network, generator = DirectInverse(rig, HIDDEN), generator_at(0, "small")

    def loss() -> Tensor:
        coordinates = random_weights(len(rig.linear_map), batch, generator) @ rig.linear_map
        return (rig(network(coordinates)) - coordinates).square().mean()

    return learn(network, loss)


def inverse_on_full_meshes(rig: LinearRig, batch: int) -> Step:
    """The same on full meshes."""
    basis, generator = rig.basis.flatten(1), generator_at(0, "full")
    network = nn.Sequential(mlp(basis.shape[1], HIDDEN, len(rig.controls)), RangeTanh(rig))

    def loss() -> Tensor:
        displacement = random_weights(len(basis), batch, generator) @ basis
        return (rig.coefficients(network(displacement)) @ basis - displacement).square().mean()

    return learn(network, loss)


def surrogate_in_mesh_space(rig: RigInMeshSpace, batch: int) -> Step:
    """Sparse controls, the paper's surrogate, the loss on the coordinates."""
    network, controls, generator = ControlMLP(rig.source), SparseControls(rig), generator_at(0, "small")

    def loss() -> Tensor:
        values = controls.sample(batch, generator)
        with torch.no_grad():
            target = rig(values)
        return (network(values) @ rig.linear_map - target).square().mean()

    return learn(network, loss)


def surrogate_on_full_meshes(rig: RigInMeshSpace, batch: int) -> Step:
    """The same on full meshes."""
    network, controls, generator = ControlMLP(rig.source), SparseControls(rig), generator_at(0, "full")
    basis = rig.source.basis.flatten(1)

    def loss() -> Tensor:
        values = controls.sample(batch, generator)
        with torch.no_grad():
            target = rig.source.coefficients(values) @ basis
        return (network(values) @ basis - target).square().mean()

    return learn(network, loss)


def median_seconds(steps: dict[str, Step], rounds: int) -> dict[str, float]:
    """The median time of each step; they take turns, so that a machine that slows down slows all of them."""
    times: dict[str, list[float]] = {name: [] for name in steps}
    for number in range(rounds + 2):
        for name, step in steps.items():
            start = time.perf_counter()
            step()
            if number >= 2:  # the first two warm up
                times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def main() -> None:
    """Time the steps and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15, help="timed rounds of all steps")
    parser.add_argument("--batch", type=int, default=64)
    given = parser.parse_args()
    torch.manual_seed(0)
    face, larger = FaceRig(), LargerFace()
    small = RigInMeshSpace(face, MeshSpace.from_rig(face))
    small_of_larger = RigInMeshSpace(larger, MeshSpace.from_rig(larger))
    seconds = median_seconds(
        {
            "inverse, mesh": inverse_in_mesh_space(small, given.batch),
            "inverse, ten times": inverse_in_mesh_space(small_of_larger, given.batch),
            "inverse, full": inverse_on_full_meshes(face, given.batch),
            "surrogate, mesh": surrogate_in_mesh_space(small, given.batch),
            "surrogate, full": surrogate_on_full_meshes(small, given.batch),
        },
        given.rounds,
    )
    print(f"{torch.get_num_threads()} threads, batch {given.batch}, median of {given.rounds} rounds taken in turn")
    for name in ("inverse", "surrogate"):
        mesh, full = seconds[f"{name}, mesh"], seconds[f"{name}, full"]
        print(f"{name} step: {full / mesh:.1f}x faster in mesh coordinates: {1e3 * mesh:.1f} ms against {1e3 * full:.0f} ms")
    change = seconds["inverse, ten times"] / seconds["inverse, mesh"] - 1
    print(f"ten times the vertices: {change:+.1%} for the step in mesh coordinates")


if __name__ == "__main__":
    main()
