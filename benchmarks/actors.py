"""How well controls are found for an actor whose face at rest lies 4.3 mm from the default face's.

    python benchmarks/actors.py [take.csv] [row ...]

The clips are those of examples/another_actor.py: a Live Link Face recording, or without one a simulated performance, by the
face's own logic, on a smooth field drawn by seed, with head motion. The figures are mean absolute errors of the controls
that are used, as fractions of their ranges, of `riginv.invert` from file to file, and the same of the weights of the primary
shapes that they drive: several of the 137 controls drive one shape, and the mesh tells its weight alone. SEEDS, FRAMES, STRIDE
and OPTIONS change what is run: a take of which every frame is far from the last needs OPTIONS=method=levenberg_marquardt. The
rows of scans keep 40 % of the faces, no vertex, and only what cameras before the face see (`scan_making.Degradation`).
"""

import csv
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from scan_making import Degradation, make_scan

from rigs.face import FaceRig

EXAMPLE = Path(__file__).parent.parent / "examples/another_actor.py"
SEEDS, FRAMES, STRIDE = (int(os.environ.get(*pair)) for pair in (("SEEDS", "3"), ("FRAMES", "300"), ("STRIDE", "1")))
OPTIONS = ["reading.unit=mm", "reading.up=y", "look.page=false", "look.sheet=false", *os.environ.get("OPTIONS", "").split()]
USED = 0.01  # a control that exceeds it in some frame is used


class Row(NamedTuple):
    """A row: which neutral is given, whether all 137 controls are free or ARKit's 52, whether the head moves, and scans."""

    neutral: str
    all_controls: bool = False
    moves: bool = True
    scans: bool = False


ROWS = {
    "ignored": Row(""),
    "given": Row("file"),
    "solve": Row("solve"),
    "given-still": Row("file", moves=False),
    "solve-still": Row("solve", moves=False),
    "given-all": Row("file", all_controls=True),
    "solve-all": Row("solve", all_controls=True),
    "scans-ignored": Row("", all_controls=True, scans=True),
    "scans-given": Row("file", all_controls=True, scans=True),
    "scans-solve": Row("solve", all_controls=True, scans=True),
}


def measure(row: Row, seed: int, take: str | None, folder: Path) -> tuple[float, float, float]:
    """The mean error of the controls that are used and of the shapes that are, and the seconds that it took."""
    example = [sys.executable, str(EXAMPLE), str(folder), f"--frames={FRAMES}", f"--stride={STRIDE}", f"--seed={seed}"]
    subprocess.run(example + ([f"--take={take}"] if take else []) + ["--still"] * (not row.moves), check=True)
    names, truth = read(folder / "truth.csv")
    options = [] if row.all_controls else [f"controls.activate=[{','.join(names)}]"]
    if row.neutral:
        options.append(f"actor.neutral={folder / 'neutral.obj' if row.neutral == 'file' else row.neutral}")
    if row.scans:
        write_scans(folder / "take.npz", seed)
        options.append("correspondence=surface")
    command = [sys.executable, "-m", "riginv.invert", "rig=face", f"clip={folder / 'take.npz'}", f"out={folder / 'out'}"]
    started = time.monotonic()
    subprocess.run([*command, *OPTIONS, *options], check=True, capture_output=True)
    seconds = time.monotonic() - started
    columns, found = read(folder / "out/curves.csv")
    shapes = error_of_used(shape_weights(columns, found), shape_weights(names, truth))
    return error_of_used(found[:, [columns.index(name) for name in names]], truth), shapes, seconds


def error_of_used(found: np.ndarray, truth: np.ndarray) -> float:
    """The mean absolute error of the columns that exceed `USED` in the truth."""
    return float(np.abs(found - truth)[:, truth.max(axis=0) > USED].mean())


@torch.no_grad()
def shape_weights(names: list[str], values: np.ndarray) -> np.ndarray:
    """The weights `(frame, shape)` of the face's primary shapes, of controls `(frame, control)` by name."""
    rig = FaceRig()
    rows = [names.index(name) for name in rig.control_names if name in names]
    controls = rig.neutral_controls.repeat(len(values), 1)
    controls[:, [name in names for name in rig.control_names]] = torch.from_numpy(values[:, rows]).float()
    return rig.coefficients(controls)[:, : rig.primary_count].numpy()


def write_scans(path: Path, seed: int) -> None:
    """Put scans in the place of a clip of the rig's own mesh."""
    with np.load(path) as take:
        meshes, faces, rate = take["vertices"], take["faces"], take["fps"]
    rng = np.random.default_rng(seed)
    points, triangles = zip(*(make_scan(mesh, faces, Degradation(), rng) for mesh in meshes))
    offsets, face_offsets = (np.cumsum([0, *map(len, arrays)]) for arrays in (points, triangles))
    arrays = {"points": np.concatenate(points), "faces": np.concatenate(triangles)}
    np.savez(path, offsets=offsets, face_offsets=face_offsets, fps=rate, **arrays)


def read(path: Path) -> tuple[list[str], np.ndarray]:
    """The columns and numbers of a CSV."""
    with path.open() as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, float)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    given = arguments.pop(0) if arguments and arguments[0].endswith(".csv") else None
    for name in arguments or ROWS:
        results = []
        for number in range(SEEDS):
            with tempfile.TemporaryDirectory() as temporary:
                results.append(measure(ROWS[name], number, given, Path(temporary)))
        errors, shapes, took = zip(*results)
        each = ", ".join(f"{error:.4f}" for error in errors)
        print(f"{name:12s} {np.mean(errors):.4f} of the range ({each} by seed),", end=" ")
        print(f"shapes {np.mean(shapes):.4f}, {np.mean(took):.0f} s", flush=True)
