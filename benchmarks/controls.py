"""Whether an inverse finds the right controls: sparse poses of the rig, and a take that the rig's own controls make.

python benchmarks/controls.py runs/face/bundle
"""

import argparse

import torch

from riginv.clips.performance import FPS, strokes
from riginv.evaluation.results import evaluate_inverse
from riginv.inference.inverse import load_inverse
from riginv.rig.batches import generator_at
from riginv.rig.control_effects import ControlEffects
from riginv.rig.interface import RigBackend
from riginv.rig.mesh_sets import MeshSet, PosedRig
from riginv.rig.random_controls import sparse_controls
from riginv.runs.tables import print_results

SEED, POSES, FRAMES, MAX_ACTIVE = 20221206, 500, 600, 10


def sets_of(rig: RigBackend) -> list[MeshSet]:
    """Random poses with at most `MAX_ACTIVE` active controls, and a take whose controls rise and fall smoothly."""
    limits = rig.lower, rig.upper, rig.neutral_controls
    sparse = sparse_controls(*limits, MAX_ACTIVE, POSES, generator_at(SEED, "sparse poses"))
    curves = strokes(list(rig.control_names), FRAMES)
    take = PosedRig("own take", rig, torch.lerp(rig.neutral_controls.expand_as(curves), rig.upper.expand_as(curves), curves))
    take.fps = FPS
    return [PosedRig("sparse poses", rig, sparse), take]


def main() -> None:
    """Print the accuracy of the network alone, with Levenberg-Marquardt steps after it, and with fewer controls after these."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle")
    parser.add_argument("--refine", type=int, nargs="*", default=[5])
    given = parser.parse_args()
    for refine, fewer in [(0, False), *((refine, fewer) for refine in given.refine for fewer in (False, True))]:
        inverse = load_inverse(given.bundle, refine=refine, fewer_controls=fewer)
        effects, metrics = ControlEffects.of_rig(inverse.rig), {"true_rig": inverse.rig.name}
        for meshes in sets_of(inverse.rig):
            metrics |= evaluate_inverse(inverse, inverse.rig, meshes).with_accuracy(effects).metrics
        print_results(metrics, f"{given.bundle}, refine={refine}, fewer_controls={str(fewer).lower()}")


if __name__ == "__main__":
    main()
