"""Correctives of Meta's Aura that were taken away at random and found again in its animation: the row of issue 19.

    python benchmarks/missing_shapes.py FOLDER [draw ...]      FOLDER: shapes.npz, logic.json and animation.npz of Aura
    SOLVED=1 NOISE=0.05 python benchmarks/missing_shapes.py FOLDER 0 1 2

Of the correctives that move more than 1 mm in every seventh frame, and that are part of no other's name, each draw takes 20
away. Shapes are found with the curves given, or, with SOLVED=1, with controls solved by Levenberg-Marquardt; NOISE: mm, at each
vertex. A line for each draw: shapes found with their drivers, those with a cosine of at least 0.9 (as in shapes.npz), all
shapes that were reported, mean errors in mm without and with them, and seconds of one core (`time.process_time`).
"""

import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from aura_rig import write_aura

from riginv.methods.solvers import LevenbergMarquardt
from riginv.rig.mesh_sets import StoredMeshes
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.tracking.missing.finding import Missing, find_missing
from riginv.tracking.missing.results import delta_to_add
from rigs.shapes import ShapesRig

SOLVED, NOISE = bool(os.environ.get("SOLVED")), float(os.environ.get("NOISE", "0"))


def words(name: str) -> tuple[str, ...]:
    return tuple(sorted(name.split("_")))


def cosines(found: Missing, whole: ShapesRig, gone: set[str]) -> list[float]:
    """Of the shapes that were taken away and found with their drivers; the best of each."""
    true, best = {words(name): name for name in gone}, {}
    for driver, shape in zip(found.rig.drivers, found.shapes):
        name = true.get(words("_".join(found.rig.factors.names[factor] for factor in driver.factors)))
        if name is not None:
            delta = whole.basis[whole.coefficient_names.index(name)]
            cosine = torch.cosine_similarity(delta.flatten(), delta_to_add(found.rig, driver, shape).flatten(), dim=0)
            best[name] = max(best.get(name, -1.0), float(cosine))
    return list(best.values())


def run_draw(draw: int, folder: Path, whole: ShapesRig, controls: torch.Tensor) -> str:
    largest = whole.basis.norm(dim=2).amax(dim=1) * whole.coefficients(controls).amax(dim=0)
    parts = {part for members in whole.shapes.combinations.values() for part in members}
    first = len(whole.controls)
    moving = [name for name, size in zip(whole.coefficient_names[first:], largest[first:]) if size > 1 and name not in parts]
    gone = set(np.random.default_rng(draw).choice(moving, 20, replace=False).tolist())
    (folder / f"less{draw}").mkdir()
    shutil.copy(folder / "aura/neutral.obj", folder / f"less{draw}")
    with np.load(folder / "aura/deltas.npz") as table:
        np.savez(folder / f"less{draw}/deltas.npz", **{name: table[name] for name in table.files if name not in gone})
    less, meshes = ShapesRig(str(folder / f"less{draw}"), unit_mm=10), whole(controls)
    meshes = meshes + NOISE * torch.randn(meshes.shape, generator=torch.Generator().manual_seed(0))
    if SOLVED:
        solver = LevenbergMarquardt(RigInMeshSpace(less, MeshSpace.from_rig(less)), sparsity=2e-5)
        controls = solver.invert(StoredMeshes("take", meshes, 30.0))
    start = time.process_time()
    found = find_missing(less, meshes, controls, 24, 4, known=not SOLVED)
    seconds, right = time.process_time() - start, cosines(found, whole, gone)
    errors = f"{float(found.before_mm.mean()):.4f} to {float(found.after_mm.mean()):.4f} mm"
    near = sum(cosine >= 0.9 for cosine in right)
    return f"draw {draw}: {len(right)} of 20, {near} with 0.9, {len(found.shapes)} reported, {errors}, {seconds:.1f} s"


def main(source: Path, draws: list[int]) -> None:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        animation = write_aura(source, Path(name), None).animation
        whole = ShapesRig(f"{name}/aura", unit_mm=10)
        with np.load(f"{name}/{animation}") as take:
            columns = [take["names"].tolist().index(control) for control in whole.control_names]
            controls = torch.tensor(take["controls"][::7, columns])
        for draw in draws:
            print(run_draw(draw, Path(name), whole, controls), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), [int(draw) for draw in sys.argv[2:]] or [0, 1, 2, 3, 4])
