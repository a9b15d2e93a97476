"""Solvers of the face side by side, timed in one run: how much faster than what is published.

    python benchmarks/solvers.py [--frames 96] [--clip take.csv]

Without a clip a simulated performance is solved. The coordinate descent is the linear core of that of Rackovic
et al., on the weights of the same basis: as published, where every update passes over all coordinates of all vertices, and in
Gram form, where K = B B^T carries everything. Both take the same steps; how far they differ is printed.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from riginv.clips.live_link import live_link_clip
from riginv.clips.performance import simulated_performance
from riginv.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.clip import solve_clip
from riginv.solvers.every_mesh import solve_frames, solve_meshes
from riginv.solvers.objective import Objective
from riginv.solvers.smoothing import smoothed
from rigs.face import FaceRig

ITERATIONS = 7  # of the published coordinate descent


def seconds(task: Callable[[], object]) -> tuple[float, object]:
    """How long a task takes, and its result."""
    start = time.perf_counter()
    result = task()
    return time.perf_counter() - start, result


def descent_on_vertices(basis: Tensor, target: Tensor) -> Tensor:
    """Coordinate descent on the weights `(shape,)` in [0, 1] of `basis` `(shape, value)`: a pass over all values an update."""
    weights, residual = target.new_zeros(len(basis)), target.clone()
    for _ in range(ITERATIONS):
        for shape, deltas in enumerate(basis):
            change = (weights[shape] + deltas @ residual / (deltas @ deltas)).clamp(0, 1) - weights[shape]
            weights[shape] += change
            residual -= change * deltas
    return weights


def descent_in_gram_form(gram: Tensor, projected: Tensor) -> Tensor:
    """The same with K = B B^T `(shape, shape)` and B t `(shape,)`: an update passes over the shapes."""
    weights, left = torch.zeros_like(projected), projected.clone()
    for _ in range(ITERATIONS):
        for shape, row in enumerate(gram):
            change = (weights[shape] + left[shape] / row[shape]).clamp(0, 1) - weights[shape]
            weights[shape] += change
            left -= change * row
    return weights


@torch.no_grad()
def main() -> None:
    """Time the solvers and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=96, help="in a row, from a tenth into the clip")
    parser.add_argument("--clip", type=Path, help="a Live Link Face CSV")
    given = parser.parse_args()
    face = FaceRig()
    space = MeshSpace.from_rig(face)
    objective = Objective(RigInMeshSpace(face, space))
    clip = live_link_clip(given.clip, face) if given.clip else simulated_performance(face)
    first = len(clip) // 10
    vertices = clip.vertices(first, min(first + given.frames, len(clip)))
    frames, coordinates = len(vertices), space.encode(vertices)

    def error_mm(units: Tensor) -> float:
        return float((face(objective.own_units(units)) - vertices).norm(dim=2).mean())

    print(f"{torch.get_num_threads()} threads, {frames} frames of {clip.name}, ms a frame")
    basis, target = face.basis.flatten(1), (vertices[0] - face.rest_vertices).flatten()
    published, weights = seconds(lambda: descent_on_vertices(basis, target))
    gram = basis @ basis.T
    in_gram_form, same = seconds(lambda: descent_in_gram_form(gram, basis @ target))
    print(f"coordinate descent, as published  {1e3 * published:8.1f}")
    print(f"coordinate descent, Gram form     {1e3 * in_gram_form:8.1f}   differs by {(weights - same).abs().max():.1e}")

    many, best = seconds(lambda: solve_meshes(objective, coordinates, 8, 60, 1e-5))
    least = error_mm(best.units)
    print(f"Levenberg-Marquardt, 8 starts     {1e3 * many / frames:8.1f}   {least:.4f} mm")
    alone, found = seconds(lambda: solve_frames(objective, coordinates))
    error = error_mm(found.units)
    print(f"Levenberg-Marquardt, as a clip    {1e3 * alone / frames:8.1f}   {error:.4f} mm, {error / least:.3f} of 8 starts'")

    def whole() -> Tensor:
        start = smoothed(solve_frames(objective, coordinates, rounds=0), 3.0)
        return solve_clip(objective, coordinates, start, 1.5, 4)

    together, smooth = seconds(whole)
    error = error_mm(smooth)
    print(
        f"the whole clip, smooth            {1e3 * together / frames:8.1f}   {error:.4f} mm, {error / least:.3f} of 8 starts'"
    )
    print(
        f"as a clip, {published * frames / alone:.0f}x faster than the published descent, which stops at weights, not controls;"
    )
    print(f"its Gram form is {published / in_gram_form:.0f}x faster than itself")


if __name__ == "__main__":
    main()
