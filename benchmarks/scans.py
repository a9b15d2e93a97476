"""Controls from scans of another topology, against the take that they were made of: the rows of issue 18.

    python benchmarks/scans.py TAKE.csv [row ...]      rows: a, b, none, run, noisy-run, tongue; all unless named
    SEEDS=1 FRAMES=40 RUN=90 python benchmarks/scans.py take.csv a
    SWAP=1 python benchmarks/scans.py take.csv a       the prior from the second half, frames of the first half
    python benchmarks/scans.py AURA a                  another rig: the folder of Meta's Aura (benchmarks/aura_rig.py)

TAKE.csv is a Live Link Face recording, whose 52 curves are added linearly to the default face: meshes near the rig's reach, but
not in it. So are the curves of Aura's own animation to its 72 shapes; EXACT=1 plays them by Aura's logic, with an optimum of
nearly 0. The prior is learned from the take's first half; frames of the second half are judged by their true vertices, in
the rig's own frame, over all of them (8,447 of the face). `x` is over the best same-topology answer (Levenberg-Marquardt from
three starts).
Scans keep 40 % of the faces, no vertex, and only what 24 cameras before the face see.

a           as they are, prior from the other half of the take
b           0.3 mm of noise, 20 % cut out as holes, turned by 20 degrees and moved by 50 mm, the same prior
none        as a, without any take: the default prior
run         90 frames in a row, each from the one before and then all at once, scans as a
noisy-run   the same with noise and holes
tongue      as b, turned by 15 degrees, the default prior; the tongue is out and the jaw open in every frame (the face only)
Seconds are of one core's time (`time.process_time`), which other processes beside it lengthen.
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from aura_rig import write_aura
from scan_making import Degradation, make_scan
from torch import Tensor

from riginv.clips.live_link import live_link_clip
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import WeightedShapes
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.every_mesh import solve_meshes
from riginv.solvers.objective import Objective
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import ControlPrior, blended, learn_prior
from riginv.tracking.priors.takes import read_take
from riginv.tracking.stability import stability_weights
from riginv.tracking.surfaces.clip import ScanSmoothness, cached_scans, smooth_scans
from riginv.tracking.surfaces.matching import Target
from riginv.tracking.surfaces.solving import ScanSolver, SolvedScan
from riginv.tracking.surfaces.triangles import TriangleMesh
from rigs.face import FaceRig
from rigs.shapes import ShapesRig

CLEAN = Degradation()
NOISY = Degradation(noise_mm=0.3, holes=0.2, degrees=20, shift_mm=50)
SEEDS, FRAMES, RUN = (int(os.environ.get(*pair)) for pair in (("SEEDS", "3"), ("FRAMES", "40"), ("RUN", "90")))
SWAP, EXACT = (os.environ.get(name) == "1" for name in ("SWAP", "EXACT"))
LOST_MM = 1.5  # mean error of a frame that counts as lost


@dataclass(frozen=True)
class Row:
    """A row of the table: how scans are spoilt, which prior, whether the frames follow one another, and with the tongue out."""

    how: Degradation
    take_prior: bool = True
    in_a_row: bool = False
    tongue: bool = False


ROWS = {
    "a": Row(CLEAN),
    "b": Row(NOISY),
    "none": Row(CLEAN, take_prior=False),
    "run": Row(CLEAN, in_a_row=True),
    "noisy-run": Row(replace(NOISY, degrees=0, shift_mm=0), in_a_row=True),
    "tongue": Row(replace(NOISY, degrees=15), take_prior=False, tongue=True),
}


Played = tuple[LinearRig, WeightedShapes, Callable[[int, int], Tensor]]  # and the controls of some of its frames


class Bench:
    """The rig, the take, and the priors, each made once."""

    def __init__(self, take: Path) -> None:
        self.rig, self.clip, controls = of_aura(take) if take.is_dir() else of_face(take)
        self.faces, half = self.rig.faces.numpy(), len(self.clip) // 2
        self.start, self.stop = (0, half) if SWAP else (half, len(self.clip))  # of the frames that are judged
        self.without = default_prior(self.rig)
        learned = learn_prior(self.rig, controls(half, len(self.clip)) if SWAP else controls(0, half), "the other half")
        self.learned = blended(learned, self.without)
        self.stability = stability_weights(self.rig).numpy()
        self.objective = Objective(RigInMeshSpace(self.rig, MeshSpace.from_rig(self.rig)))

    def truth(self, frames: np.ndarray) -> Tensor:
        return torch.cat([self.clip.vertices(frame, frame + 1) for frame in frames.tolist()])

    def with_tongue(self, frames: np.ndarray) -> Tensor:
        """The meshes of frames whose tongue is out and whose jaw is open, by other amounts in each."""
        names, rng, clip = list(self.rig.arkit_deltas()), np.random.default_rng(7), self.clip
        weights = clip.weights[frames].clone()
        for name, least, most in (("tongueOut", 0.5, 1.0), ("jawOpen", 0.3, 0.9), ("mouthClose", 0.0, 0.0)):
            weights[:, names.index(name)] = torch.from_numpy(rng.uniform(least, most, len(frames))).to(weights)
        return WeightedShapes("tongue", self.rig.rest_vertices, clip.deltas, weights, clip.fps).vertices(0, len(frames))

    @torch.no_grad()
    def best(self, truth: Tensor) -> np.ndarray:
        """The error of the best same-topology answers, `(frame,)`."""
        found = solve_meshes(self.objective, self.objective.rig.space.encode(truth), 3, 60, descent_steps=60)
        return self.errors(self.objective.to_controls(found.units), truth)

    @torch.no_grad()
    def errors(self, controls: Tensor, truth: Tensor) -> np.ndarray:
        return (self.rig(controls) - truth).norm(dim=2).mean(dim=1).numpy()

    def solver(self, prior: ControlPrior) -> ScanSolver:
        return ScanSolver(self.rig, prior, stability=self.stability)

    def run(self, name: str) -> None:
        """Measure a row and print it."""
        row = ROWS[name]
        start = self.start + 985
        frames = (
            np.arange(start, start + RUN) if row.in_a_row else np.linspace(self.start + 10, self.stop - 10, FRAMES).astype(int)
        )
        truth = self.with_tongue(frames) if row.tongue else self.truth(frames)
        best, found, seconds = self.best(truth), [], []
        for seed in range(SEEDS):
            solver = self.solver(self.learned if row.take_prior else self.without)
            scans = [
                make_scan(mesh.numpy(), self.faces, row.how, np.random.default_rng([seed, int(frame)]))
                for mesh, frame in zip(truth, frames)
            ]
            answers, took = solved(solver, scans, row.in_a_row)
            controls = torch.stack([solver.fit_of(1.0).controls(answer.state.units) for answer in answers])
            found.append(self.errors(controls, truth))
            seconds.append(took)
        errors = np.stack(found)
        neutral = (self.rig.rest_vertices - truth).norm(dim=2).mean()
        ratio, lost = errors / best, int((errors > LOST_MM).sum())
        print(f"{name:9s} neutral {neutral:.2f}, optimum {best.mean():.3f}, found {errors.mean():.3f} mm", end="")
        print(f" ({', '.join(f'{each.mean():.3f}' for each in errors)} by seed)", end="")
        print(f": {errors.mean() / best.mean():.2f} x, median {np.median(ratio):.2f} x, worst {errors.max():.2f} mm", end="")
        print(f", {lost} of {errors.size} lost, {np.mean(seconds):.2f} s a frame", flush=True)


def of_face(take: Path) -> Played:
    """The default face, and a Live Link Face recording on it."""
    rig = FaceRig()
    return rig, live_link_clip(take, rig), lambda first, stop: read_take(take, rig, first, stop - 1).controls


def of_aura(source: Path) -> Played:
    """Aura as a folder of shapes, and its own animation."""
    with tempfile.TemporaryDirectory() as folder:
        aura = write_aura(source, Path(folder), None)
        rig = ShapesRig(f"{folder}/aura", unit_mm=10)
        controls = read_take(Path(folder) / aura.animation, rig).controls
    with torch.no_grad():
        weights = rig.coefficients(controls) if EXACT else controls
    clip = WeightedShapes("aura", rig.rest_vertices, rig.basis[: weights.shape[1]], weights, 30.0)
    return rig, clip, lambda first, stop: controls[first:stop]


def solved(solver: ScanSolver, scans: list, in_a_row: bool) -> tuple[list[SolvedScan], float]:
    """The answers, and the seconds of a core's time that each took."""

    def read(number: int) -> Target:
        return solver.target(TriangleMesh(*scans[number]))

    target = cached_scans(read)
    started, before, answers = time.process_time(), None, []
    for number in range(len(scans)):
        before = solver.solve(target(number), before if in_a_row else None)
        answers.append(before if in_a_row else solver.finished(target(number), before))
    if in_a_row:
        answers = smooth_scans(solver, target, answers, ScanSmoothness())
    return answers, (time.process_time() - started) / len(scans)


if __name__ == "__main__":
    bench = Bench(Path(sys.argv[1]))
    for row_name in sys.argv[2:] or ROWS:
        bench.run(row_name)
