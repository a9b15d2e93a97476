"""How fast a trained inverse is, full vertices in, controls out, and what it gains by its quick encoding; in one run.

    python benchmarks/inference.py BUNDLE [--rounds 40] [--batch 64]

Both ways take turns; the median of their times counts.
"""

import argparse
import statistics
import time

import torch

from riginv.inference.inverse import load_inverse


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", help="a bundle of an inverse, or the run that holds it")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--batch", type=int, default=64)
    options = parser.parse_args()
    quick, exact = load_inverse(options.bundle), load_inverse(options.bundle)
    exact.encoder.sparse = exact.encoder.frame = None
    rig = quick.rig
    torch.manual_seed(0)
    controls = rig.neutral_controls + 0.3 * torch.rand(options.batch, len(rig.controls)) * (rig.upper - rig.neutral_controls)
    vertices = rig(controls)
    times: dict[str, list[float]] = {"as it is": [], "dense encoding": []}
    for _ in range(options.rounds + 2):
        for name, inverse in zip(times, (quick, exact)):
            began = time.perf_counter()
            inverse(vertices)
            times[name].append(time.perf_counter() - began)
    print(f"{len(vertices)} meshes of {len(rig.rest_vertices)} vertices at once, {torch.get_num_threads()} threads")
    for name, seconds in times.items():
        median = statistics.median(seconds[2:])  # the first two warm up
        print(f"  {name:<15} {options.batch / median:8,.0f} frames/s, {1000 * median / options.batch:.2f} ms a frame")


if __name__ == "__main__":
    main()
