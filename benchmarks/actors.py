"""How well controls are found for an actor whose face at rest lies 4.3 mm from the default face's.

    python benchmarks/actors.py [take.csv] [row ...]

A Live Link Face recording, or without one a simulated performance, gives the controls with ARKit's names; the face's own logic
makes the meshes. An actor is a smooth field on top, drawn by seed; the head turns by up to 20 degrees and moves by 30 mm. The
figures are mean absolute errors of the controls that are used, as fractions of their ranges, of `python -m riginv.invert` from
file to file. SEEDS, FRAMES and MOTION=0 change what is measured.
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
import roma
import torch
from torch import Tensor

from riginv.clips.performance import simulated_performance
from riginv.meshes.obj import obj_text
from riginv.tracking.rigid import apply_motion, fit_rigid, remove_motion
from rigs.face import FaceRig

SEEDS, FRAMES, MOTION = (int(os.environ.get(*pair)) for pair in (("SEEDS", "3"), ("FRAMES", "300"), ("MOTION", "1")))
OFFSET_MM, BUMPS, WIDTH_MM = 4.3, 40, 35.0  # mean size of an actor's field, and the smooth bumps that make it
USED = 0.01  # a control that exceeds it in some frame is used


class Row(NamedTuple):
    """A row of the table: whether it is another actor, which neutral is given, and whether all 137 controls are free."""

    is_actor: bool
    neutral: str
    all_controls: bool = False


ROWS = {
    "rig-itself": Row(False, ""),
    "ignored": Row(True, ""),
    "given": Row(True, "file"),
    "solve": Row(True, "solve"),
    "given-all": Row(True, "file", all_controls=True),
    "solve-all": Row(True, "solve", all_controls=True),
}


def offset_field(rest: Tensor, seed: int) -> Tensor:
    """A smooth field `(vertex, 3)` of `OFFSET_MM` on average, without rigid motion."""
    generator = torch.Generator().manual_seed(seed)
    centres = rest[torch.randint(0, len(rest), (BUMPS,), generator=generator)]
    field = torch.exp(-0.5 * (torch.cdist(rest, centres) / WIDTH_MM) ** 2) @ torch.randn(BUMPS, 3, generator=generator)
    for _ in range(3):
        field *= OFFSET_MM / field.norm(dim=1).mean()
        motion = fit_rigid(rest[None], (rest + field)[None], torch.ones(len(rest)))
        field = remove_motion(motion, (rest + field)[None])[0] - rest
    return field


def head_motion(frames: int) -> Tensor:
    """Rigid motions `(frame, 4, 4)`."""
    seconds = torch.arange(frames)[:, None] / 30
    motion = torch.eye(4).repeat(frames, 1, 1)
    motion[:, :3, :3] = roma.rotvec_to_rotmat(
        torch.sin(seconds * torch.tensor([0.9, 1.5, 2.1])) * torch.tensor([0.25, 0.3, 0.1])
    )
    motion[:, :3, 3] = 30 * torch.sin(seconds * torch.tensor([1.0, 0.7, 1.3]))
    return motion


class Bench:
    """The face and the curves of a take."""

    def __init__(self, take: Path | None) -> None:
        self.rig = FaceRig()
        names = list(self.rig.arkit_deltas())
        self.columns = [self.rig.control_names.index(name) for name in names]
        curves = _recorded(take, names) if take else simulated_performance(self.rig, 900).weights
        first = (len(curves) - FRAMES) // 2
        self.truth = self.rig.neutral_controls.repeat(FRAMES, 1)
        self.truth[:, self.columns] = curves[first : first + FRAMES].clamp(0, 1).to(self.truth)
        self.used = [column for column in self.columns if float(self.truth[:, column].max()) > USED]

    def run(self, name: str) -> None:
        """Measure a row and print it."""
        row, found = ROWS[name], []
        for seed in range(SEEDS if row.is_actor else 1):
            with tempfile.TemporaryDirectory() as folder:
                found.append(self._errors(Path(folder), row, seed))
        errors, seconds = zip(*found)
        by_seed = ", ".join(f"{error:.4f}" for error in errors)
        print(f"{name:10s} {np.mean(errors):.4f} of the range ({by_seed} by seed), {np.mean(seconds):.0f} s", flush=True)

    def _errors(self, folder: Path, row: Row, seed: int) -> tuple[float, float]:
        rest, faces = self.rig.rest_vertices, self.rig.faces.numpy()
        neutral = rest + offset_field(rest, seed) if row.is_actor else rest
        with torch.no_grad():
            meshes = torch.cat([self.rig(batch) for batch in self.truth.split(64)]) - rest + neutral
        if MOTION:
            meshes = apply_motion(head_motion(len(meshes)), meshes)
            neutral = apply_motion(head_motion(FRAMES)[FRAMES // 2][None], neutral[None])[0]
        np.savez(folder / "take.npz", vertices=meshes.numpy(), faces=faces, fps=30.0)
        (folder / "rest.obj").write_text(obj_text(neutral.numpy(), faces))
        options = ["reading.unit=mm", "reading.up=y", "look.page=false", "look.sheet=false"]
        if not row.all_controls:
            options.append(f"controls.activate=[{','.join(self.rig.control_names[column] for column in self.columns)}]")
        if row.neutral:
            options.append(f"actor.neutral={folder / 'rest.obj' if row.neutral == 'file' else row.neutral}")
        command = [sys.executable, "-m", "riginv.invert", "rig=face", f"clip={folder / 'take.npz'}", f"out={folder / 'out'}"]
        started = time.monotonic()
        subprocess.run([*command, *options, *os.environ.get("OPTIONS", "").split()], check=True, capture_output=True)
        seconds = time.monotonic() - started
        with (folder / "out/curves.csv").open() as file:
            table = list(csv.DictReader(file))
        names = [self.rig.control_names[column] for column in self.used]
        controls = torch.tensor([[float(line[name]) for name in names] for line in table])
        return float((controls - self.truth[:, self.used]).abs().mean()), seconds


def _recorded(take: Path, names: list[str]) -> Tensor:
    """The curves `(frame, shape)` of a Live Link Face recording."""
    with take.open() as file:
        rows = list(csv.DictReader(file))
    return torch.tensor([[float(row[name[0].upper() + name[1:]]) for name in names] for row in rows])


if __name__ == "__main__":
    arguments = sys.argv[1:]
    given = Path(arguments.pop(0)) if arguments and arguments[0].endswith(".csv") else None
    bench = Bench(given)
    for row_name in arguments or ROWS:
        bench.run(row_name)
