"""How much more N Blender workers evaluate than one; both are timed in one run, taking turns.

    python benchmarks/blender_workers.py [--workers 2] [--poses 128] [--rounds 5]

The rig is the Blender twin of the default face. Loading is not timed: it happens once. The best round counts. Beside
it stands what as many plain Python loops gain at that time: on a machine that others use it is less than N.
"""

import argparse
import subprocess
import sys
import time

import torch

from riginv.evaluation.evaluation_sets import random_poses
from rigs.blender.rig import BlenderRig
from rigs.face import FaceRig

LOOP = "s = 0\nfor i in range(10_000_000): s += i * i % 7"


def loops_s(count: int) -> float:
    """How long `count` plain loops take, all at once, each in a process of its own."""
    start = time.perf_counter()
    for process in [subprocess.Popen([sys.executable, "-c", LOOP]) for _ in range(count)]:
        process.wait()
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--poses", type=int, default=128)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    face = FaceRig()
    rigs = {count: BlenderRig(workers=count, twin_of=face) for count in (1, arguments.workers)}
    controls = random_poses(face, arguments.poses).controls
    for rig in rigs.values():
        rig(controls)  # starts the workers
    rates: dict[int, list[float]] = {count: [] for count in rigs}
    gains: dict[int, list[float]] = {count: [] for count in rigs}
    for _ in range(arguments.rounds):
        for count, rig in rigs.items():
            start = time.perf_counter()
            rig(controls)
            rates[count].append(arguments.poses / (time.perf_counter() - start))
        for count in gains:
            gains[count].append(count / loops_s(count))
    for count in rigs:
        print(f"workers: {count}, poses/s: best {max(rates[count]):.1f}, all {[round(rate, 1) for rate in rates[count]]}")
    gain = max(rates[arguments.workers]) / max(rates[1])
    plain = max(gains[arguments.workers]) / max(gains[1])
    print(f"ratio: {gain:.2f}, for each worker {gain / arguments.workers:.2f}; plain loops: {plain:.2f}")
    torch.testing.assert_close(rigs[1](controls[:2]), rigs[arguments.workers](controls[:2]))


if __name__ == "__main__":
    main()
