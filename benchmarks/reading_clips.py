"""python benchmarks/reading_clips.py: how fast clips of the default face are read, on one core."""

import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from riginv.clips.open import open_sequence
from rigs.face import FaceRig
from tests.support.clips import obj_sequence, ply_sequence, reading_options, write_mdd, write_npz, write_pc2

FRAMES = 60
OPTIONS = reading_options()


def main() -> None:
    """Write a clip in each format, read it window by window, and show megabytes and frames a second."""
    torch.set_num_threads(1)
    face = FaceRig()
    meshes = face.rest_vertices.numpy() + np.linspace(0, 5, FRAMES)[:, None, None]
    faces = face.faces.numpy()
    table = Table("clip", "MB", "MB/s", "frames/s")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clips: dict[str, str | Path] = {
            "npz": write_npz(folder / "a.npz", meshes, faces),
            "npz, compressed": write_npz(folder / "b.npz", meshes, faces, compressed=True),
            "OBJ": obj_sequence(folder / "obj", meshes, faces),
            "PLY, binary": ply_sequence(folder / "ply", meshes, faces),
            "PLY, text": ply_sequence(folder / "text", meshes, faces, "ascii"),
            "MDD": write_mdd(folder / "a.mdd", meshes),
            "PC2": write_pc2(folder / "a.pc2", meshes),
        }
        for kind, path in clips.items():
            sequence = open_sequence(str(path), face, OPTIONS)
            files = Path(path).parent.glob("shot*") if kind[:3] in ("OBJ", "PLY") else [Path(path)]
            size = sum(file.stat().st_size for file in files) / 1e6
            began = time.perf_counter()
            for start in range(0, FRAMES, 20):
                sequence.read(start, start + 20)
            seconds = time.perf_counter() - began
            table.add_row(kind, f"{size:.1f}", f"{size / seconds:.0f}", f"{FRAMES / seconds:.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
