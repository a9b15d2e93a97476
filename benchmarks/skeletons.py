"""How well riginv.invert recovers the animations of skinned creatures from their meshes: by their joints, without a network.

    python benchmarks/skeletons.py [FILE.glb ...]

Without files: creatures of tubes (`tests/support/creatures.py`), one of them in a file of centimetres. Prints, for the first animation of each, the
mean error over the mesh's size, the worst vertex, the frames that have converged, and the time a frame.
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
from riginv.tracking.run import invert_smoothly
from rigs.gltf import GltfRig
from tests.support.creatures import CREATURES, write_creature


def main() -> None:
    """Invert the first animation of each file."""
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(name) for name in sys.argv[1:]]
        if not files:
            files = [write_creature(Path(folder) / f"{name}.glb", make()) for name, make in CREATURES.items()]
            files.append(write_creature(Path(folder) / "fox_in_cm.glb", CREATURES["fox"](), unit=100.0))
        print(
            "file, joints, controls, vertices, frames, mean error / size, worst / size, converged, ms a frame, ms of one core's time a frame, s to start"
        )
        for file in files:
            print(figures(file), flush=True)


def figures(file: Path) -> str:
    """A line on one file."""
    started = time.monotonic()
    rig = GltfRig(str(file), joints=True)
    clip, _ = open_clip(str(file), rig, ReadingOptions(readers={"glb": "rigs.gltf.clip.GltfClip"}), FrameOptions())
    options = TrackingOptions()
    parts = build_parts(options, clip, rig, rig, None)
    prepared, cpu = time.monotonic(), time.process_time()
    found = invert_smoothly(clip, parts.inverter, parts.evaluator, options.window, lambda *_: None, options.solver)
    seconds, cpu = time.monotonic() - prepared, time.process_time() - cpu
    size = float((rig.rest_vertices.amax(dim=0) - rig.rest_vertices.amin(dim=0)).norm())
    errors = found.errors
    converged = sum("not_converged" not in flags for flags in errors.flags) / len(clip)
    joints = 0 if rig.joint_motion is None else rig.joint_motion.count
    return (
        f"{file.name}, {joints}, {len(rig.controls)}, {len(rig.rest_vertices):,}, {len(clip)}, "
        f"{float(errors.mean_mm.mean()) / size:.1e}, {float(errors.max_mm.max()) / size:.1e}, {converged:.0%}, "
        f"{1000 * seconds / len(clip):.1f}, {1000 * cpu / len(clip):.1f}, {prepared - started:.1f}"
    )


if __name__ == "__main__":
    main()
