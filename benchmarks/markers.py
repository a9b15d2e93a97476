"""Controls from markers, against the meshes that they were made of: the rows of issue 18.

    python benchmarks/markers.py face TAKE.csv          50 markers on the default face
    python benchmarks/markers.py body                   41 markers on the body's walk
    SEEDS=1 FRAMES=600 python benchmarks/markers.py face take.csv

Markers are where `riginv.markers count=50` puts them, and, for comparison, evenly spread over the skin; 0.3 mm of noise in each
coordinate (body: 1 mm), 10 % dropped. TAKE.csv is a Live Link Face recording, whose 52 curves are added linearly to the default
face: meshes near the rig's reach, but not in it. The frames of its second half are inverted in a row; 40 of them, spread, are
evaluated by their true vertices, all 8,447 of them, in the rig's own frame. `x` is over the best same-topology answer
(Levenberg-Marquardt from three starts). `take` has a prior learned from the first half, with its changes from frame to frame,
`none` the default prior; with `motion` the head also turns by up to 20 degrees and moves by up to 50 mm, and the error is that
in the rig's own frame.
Milliseconds are of one core's time (`time.process_time`), which other processes beside it lengthen.
"""

import os
import sys
import time
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from riginv.clips.live_link import live_link_clip
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.every_mesh import solve_meshes
from riginv.solvers.objective import Objective
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.markers.assembly import build_objective, marker_prior
from riginv.tracking.markers.layout import NOISE_MM, marker_skin, suggest_layout
from riginv.tracking.markers.placement import Placement, at_vertices
from riginv.tracking.markers.tracking import MarkerTrack, track_markers
from riginv.tracking.options import ControlOptions, TrackingOptions
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.priors.prior import ControlPrior, blended, learn_prior
from riginv.tracking.priors.takes import read_take, with_changes
from riginv.tracking.surfaces.rig_surface import farthest_points
from rigs.body import BodyRig
from rigs.face import FaceRig

SEEDS, FRAMES = (int(os.environ.get(*pair)) for pair in (("SEEDS", "3"), ("FRAMES", "0")))
JUDGED, DROPPED = 40, 0.1
TONGUE_MM = 5.0  # by which `tongueOut` moves the vertices of the tongue at least


def observed(markers: Tensor, noise_mm: float, seed: int, is_moving: bool = False) -> Tensor:
    """Markers `(frame, marker, 3)` with noise, drop-outs, and perhaps the motion of a head."""
    rng = np.random.default_rng(seed)
    points = markers.double().numpy() + rng.normal(0, noise_mm, markers.shape)
    if is_moving:
        phase = np.arange(len(points)) / 50
        angles = 20 * np.sin(np.stack([phase, 1.3 * phase, 0.7 * phase], axis=1))
        rotation, middle = Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), points.mean(axis=(0, 1))
        points = (points - middle) @ rotation.transpose(0, 2, 1) + middle + 50 * np.sin(phase)[:, None, None]
    points[rng.random(points.shape[:2]) < DROPPED] = np.nan
    return torch.from_numpy(points).float()


def solved(
    rig: LinearRig, placement: Placement, points: Tensor, prior: ControlPrior, noise_mm: float, moves: bool
) -> tuple[MarkerTrack, float]:
    """The inversion of a clip, and milliseconds for each frame."""
    options = TrackingOptions(correspondence="markers", markers="-", noise_mm=noise_mm)
    began, constraints = time.process_time(), resolve_constraints(rig, ControlOptions())
    objective = build_objective(rig, placement, constraints, marker_prior(rig, prior, noise_mm), moves, options)
    track = track_markers(objective, points, torch.arange(len(points)), options.solver, noise_mm)
    return track, 1000 * (time.process_time() - began) / len(points)


def layouts(rig: LinearRig, prior: ControlPrior, count: int) -> dict[str, Placement]:
    """Where the markers are."""
    rest = rig.rest_vertices.numpy()
    skin = marker_skin(rest.astype(np.float64), rig.faces.numpy())
    spread = skin[farthest_points(rest[skin], count)].tolist()
    names = [f"m{number:02d}" for number in range(count)]
    return {"suggested": suggest_layout(rig, prior, count, NOISE_MM, 0.0), "evenly": at_vertices(rig, names, spread, 0.0)}


@torch.no_grad()
def face(take: Path) -> None:
    """Print the rows of the face."""
    rig = FaceRig()
    clip, without = live_link_clip(take, rig), default_prior(rig)
    half = len(clip) // 2
    first_half = read_take(take, rig, 0, half - 1)
    learned = with_changes(blended(learn_prior(rig, first_half.controls, "the first half"), without), rig, [first_half])
    rows = torch.arange(half, len(clip))[: FRAMES or None]
    judged = torch.linspace(5, len(rows) - 6, JUDGED).long()
    truth = torch.cat([clip.vertices(row, row + 1) for row in rows[judged].tolist()])
    objective = Objective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)))
    best = solve_meshes(objective, objective.rig.space.encode(truth), 3, 60, descent_steps=60)
    best_errors = (rig(objective.to_controls(best.units)) - truth).norm(dim=2)
    optimum = best_errors.mean(dim=1)
    neutral = (rig.rest_vertices - truth).norm(dim=2).mean()
    tongue = rig.arkit_deltas()["tongueOut"].norm(dim=1) > TONGUE_MM
    print(f"{len(rows)} frames, {JUDGED} evaluated: neutral {neutral:.2f} mm, optimum {optimum.mean():.3f} mm", flush=True)
    for where, placement in layouts(rig, without, 50).items():
        markers = torch.cat([placement.points(clip.vertices(first, first + 64)) for first in range(half, len(clip), 64)])
        for name, prior, moves in (("take", learned, False), ("none", without, False), ("take, motion", learned, True)):
            errors, spent = [], []
            for seed in range(SEEDS):
                points = observed(markers[: len(rows)], 0.3, seed, moves)
                track, milliseconds = solved(rig, placement, points, prior, 0.3, moves)
                errors.append((rig(track.controls[judged]) - truth).norm(dim=2))
                spent.append(milliseconds)
            every = torch.stack(errors)
            found = every.mean(dim=2)
            rest = every[..., ~tongue].mean() / best_errors[:, ~tongue].mean()
            seeds = ", ".join(f"{each.mean():.3f}" for each in found)
            print(
                f"face, {where}, {name}: {found.mean():.3f} mm ({seeds} by seed), {found.mean() / optimum.mean():.2f} x "
                f"(all but the tongue {rest:.2f} x),",
                end=" ",
            )
            print(f"worst {found.max():.2f} mm, {np.mean(spent):.1f} ms a frame", flush=True)


@torch.no_grad()
def body() -> None:
    """Print the rows of the body."""
    rig = BodyRig()
    truth, prior = rig.motion().vertices, default_prior(rig)
    neutral = (rig.rest_vertices - truth).norm(dim=2).mean()
    for where, placement in layouts(rig, prior, 41).items():
        errors, spent = [], []
        for seed in range(SEEDS):
            track, milliseconds = solved(rig, placement, observed(placement.points(truth), 1.0, seed), prior, 1.0, False)
            errors.append((rig(track.controls) - truth).norm(dim=2).mean(dim=1))
            spent.append(milliseconds)
        found = torch.stack(errors)
        print(
            f"body, {where}: neutral {neutral:.0f} mm, found {found.mean():.2f} mm, worst frame {found.max():.1f} mm,", end=" "
        )
        print(f"{np.mean(spent):.1f} ms a frame", flush=True)


if __name__ == "__main__":
    torch.set_num_threads(1)
    if sys.argv[1] == "body":
        body()
    else:
        face(Path(sys.argv[2]))
