"""How well riginv.invert recovers the animations of skinned creatures from their meshes: by their joints, without a network.

    python benchmarks/skeletons.py [FILE.glb ...]

Without files: creatures of tubes (`tests/support/creatures.py`), one of them in a file of centimetres. Prints, for the first
animation of each, the mean error over the mesh's size, the worst vertex, the frames that have converged, and the time a frame.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import torch

from riginv.clips.open import open_clip
from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.tracking.assembly import build_parts
from riginv.tracking.options import TrackingOptions
from riginv.tracking.run import Inversion, invert_smoothly
from rigs.gltf import GltfRig
from tests.support.creatures import CREATURES, write_creature

READERS = {"glb": "rigs.gltf.clip.GltfClip", "gltf": "rigs.gltf.clip.GltfClip"}


def main() -> None:
    """Invert the first animation of each file."""
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(name) for name in sys.argv[1:]]
        if not files:
            files = [write_creature(Path(folder) / f"{name}.glb", make()) for name, make in CREATURES.items()]
            files.append(write_creature(Path(folder) / "fox_in_cm.glb", CREATURES["fox"](), unit=100.0))
        print("file, joints, controls, vertices, frames, mean / size, worst / size, converged, ms a frame, of CPU, s to read")
        for file in files:
            print(figures(file), flush=True)


def invert_file(rig: GltfRig, file: str) -> Inversion:
    """The first animation of a file inverted as riginv.invert does."""
    clip, _ = open_clip(file, rig, ReadingOptions(readers=READERS), FrameOptions())
    options = TrackingOptions()
    parts = build_parts(options, clip, rig, rig, None)
    return invert_smoothly(clip, parts.inverter, parts.evaluator, options.window, lambda *_: None, options.solver)


def figures(file: Path) -> str:
    """A line on one file."""
    started = time.monotonic()
    rig = GltfRig(str(file), joints=True)
    read, cpu = time.monotonic(), time.process_time()
    errors = invert_file(rig, str(file)).errors
    seconds, cpu, frames = time.monotonic() - read, time.process_time() - cpu, len(errors.mean_mm)
    size = float((rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).norm())
    converged = sum("not_converged" not in flags for flags in errors.flags) / frames
    joints = 0 if rig.joint_motion is None else rig.joint_motion.count
    return (
        f"{file.name}, {joints}, {len(rig.controls)}, {len(rig.rest_vertices):,}, {frames}, "
        f"{float(errors.mean_mm.mean()) / size:.1e}, {float(errors.max_mm.max()) / size:.1e}, {converged:.0%}, "
        f"{1000 * seconds / frames:.1f}, {1000 * cpu / frames:.1f}, {read - started:.1f}"
    )


if __name__ == "__main__":
    main()
