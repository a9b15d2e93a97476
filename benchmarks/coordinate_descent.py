"""The published coordinate descent against its Gram form, and both against Levenberg-Marquardt, on frames of one clip.

Rackovic et al.'s scripts (stevorackovic/FacialAnimation, CDFunctions.py) make the whole mesh anew for every single weight.
This does
the same, on a model of their size: one-sided weights of the default face, 150 pairs, 60 triples, 30 quadruples, 25,341
coordinates, 7 iterations. The Gram form takes the same steps with K = B^T B and b = B^T t.

    python benchmarks/coordinate_descent.py
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from riginv.clips.performance import simulated_performance
from riginv.methods.baselines.coordinate_descent import GramDescent
from riginv.methods.baselines.measured import ramps, with_products
from riginv.methods.baselines.product_model import ProductModel
from riginv.methods.solvers import LevenbergMarquardt
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from rigs.face import FaceRig

PRODUCTS, SPARSITY = (150, 60, 30), 5.0
FRAME = 140  # of the clip: a frame in which much moves


class Published:
    """Each weight at its minimum in turn, by the deltas of all vertices."""

    def __init__(self, model: ProductModel, deltas: np.ndarray) -> None:
        self.deltas, self.members = deltas, model.members.numpy()
        self.used = [terms.numpy() for terms in model.terms_of_side]

    def products(self, weights: np.ndarray) -> np.ndarray:
        return np.append(weights, 1.0)[self.members].prod(axis=1)

    def __call__(self, target: np.ndarray, sides: int, iterations: int) -> np.ndarray:
        weights = np.zeros(sides)
        for _ in range(iterations):
            for side, terms in enumerate(self.used):
                weights[side] = 1.0
                derivative = self.products(weights)[terms] @ self.deltas[terms]
                weights[side] = 0.0
                rest = self.products(weights) @ self.deltas - target
                weights[side] = min(max(-(SPARSITY + derivative @ rest) / (derivative @ derivative), 0.0), 1.0)
        return weights


def seconds(work: Callable[[], object], rounds: int) -> float:
    """The median time of a piece of work."""
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


@torch.no_grad()
def main() -> None:
    """Time the three, check that the first two agree, and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=7)
    parser.add_argument("--frames", type=int, default=256, help="of the clip, for what works on many at once")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    face = FaceRig()
    rig = RigInMeshSpace(face, MeshSpace.from_rig(face))
    clip = simulated_performance(face, given.frames)
    assert clip is not None
    model = with_products(rig, ramps(rig, squares=False), PRODUCTS)
    sides = len(model.sides)
    descent = GramDescent(model, SPARSITY, groups=[[side] for side in range(sides)])
    frame = min(FRAME, given.frames - 1)
    mesh = clip.vertices(frame, frame + 1)
    target = (mesh - face.rest_vertices).flatten().double().numpy()
    published = Published(model, (model.deltas @ rig.space.directions.flatten(1).double()).numpy())
    one, many = rig.space.encode(mesh).double(), rig.space.encode(clip.vertices(0, given.frames)).double()

    def in_gram_form(coordinates: torch.Tensor) -> torch.Tensor:
        return descent(torch.zeros(len(coordinates), sides, dtype=torch.float64), coordinates, given.iterations)

    solver = LevenbergMarquardt(rig)
    solver.prepare(0)
    apart = np.abs(published(target, sides, 2) - descent(torch.zeros(1, sides).double(), one, 2)[0].numpy()).max()
    slow = seconds(lambda: published(target, sides, given.iterations), 1)
    alone = seconds(lambda: in_gram_form(one), given.rounds)
    together = seconds(lambda: in_gram_form(many), given.rounds) / given.frames
    solved = seconds(lambda: solver.invert(clip), 1) / given.frames
    print(f"{torch.get_num_threads()} threads, {sides} weights, {len(model.deltas)} terms, {given.iterations} iterations")
    print(f"published form     {1e3 * slow:9.1f} ms a frame")
    print(f"Gram form, alone   {1e3 * alone:9.1f} ms a frame: {slow / alone:.0f} times as fast")
    print(f"Gram form, {given.frames:<4} up {1e3 * together:9.2f} ms a frame: {slow / together:.0f} times as fast")
    print(
        f"Levenberg-Marquardt on the rig itself, {given.frames} frames at once {1e3 * solved:9.2f} ms a frame: "
        f"{slow / solved:.0f} times as fast"
    )
    print(f"greatest difference of a weight between the first two after two iterations: {apart:.1e}")


if __name__ == "__main__":
    main()
